"""Skinning weights of the convex twin compared: what each tells of the material, and what the fit of θ to images adds.

python benchmarks/convex_twin_weights.py --captures BENCHMARK/captures --truth BENCHMARK/truth --objects NAME

Objects of `physconvex generate benchmark`. Without geometry in a capture its first frames are reconstructed (stored in
`--work`). The weights: eigenmodes; elastic (vibrations and responses to contacts); neural (eq. 4); neural with θ fitted
to the images in turns with E and ν; predicted by the network. For each of them:

- rms distance of the surface from the true motion with the true E, ν and damping: the error of the reduced model, with
  what the reconstructed body adds;
- fit of E and ν to the pixels of the observed frames, from the same start: errors, PSNR around the object, observed and
  future, rms distance from the true motion.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch

from inference import ReconstructOptions, predict, reconstruct, with_rest_geometry
from physconvex.convex import ConvexField, read_ply
from physconvex.dynamics import simulate
from physconvex.errors import ConvergenceError
from physconvex.identify import (
    PhotometricObservations,
    Twin,
    TwinOptions,
    WeightFitOptions,
    base_twin,
    convex_twin,
    default_parameter,
    fit_in_turns,
    simulation_loss,
)
from physconvex.io import Capture, load_capture
from physconvex.reduced import WeightField, predicted_weights

RESULT = Path(__file__).parent / "results" / "convex_twin_weights.json"
NAMES = ("log10_youngs_modulus", "poisson_ratio")
BASES = ("eigenmodes", "elastic", "neural", "neural, θ fitted", "predicted")


@dataclass(frozen=True)
class Row:
    """One basis for one object.

    Attributes:
        object, basis, weights: names, and the number M of weights.
        rms_at_truth_m: rms distance from the true motion with the true material [m].
        log10_error, poisson_error: fit less truth.
        observed_psnr, future_psnr: around the object in the compared images [dB].
        rms_m: rms distance of the fitted motion from the true one [m].
        process_seconds: of weights and fit [s].
        failure: why there is no fit.
    """

    object: str
    basis: str
    weights: int
    rms_at_truth_m: float | None = None
    log10_error: float | None = None
    poisson_error: float | None = None
    observed_psnr: float | None = None
    future_psnr: float | None = None
    rms_m: float | None = None
    process_seconds: float = 0.0
    failure: str | None = None


class Case:
    """One object of a benchmark."""

    def __init__(self, name: str, options: argparse.Namespace) -> None:
        self.name, self.options = name, options
        capture = load_capture(options.captures / name)
        folder = options.work / name
        self.field = _field(capture, folder, options)
        self.capture = with_rest_geometry(capture, body=folder / "body.ply")
        self.truth = json.loads((options.truth / name / "truth.json").read_text(encoding="utf-8"))
        self.true = np.array([np.log10(self.truth["youngs_modulus"]), self.truth["poisson_ratio"]])
        with np.load(options.truth / name / "points.npz") as arrays:
            self.rest, self.positions = arrays["rest"], arrays["positions"]
        self.twin = base_twin(self.capture, TwinOptions(max_nodes=options.nodes, fill=True))
        self.network = predict(capture.folder)
        self.start = np.array([np.log10(self.network.youngs_modulus), self.network.poisson_ratio])
        self.levels = [self._seen(pixels) for pixels in options.pixels]

    def _seen(self, pixels: int) -> PhotometricObservations:
        """The front video, all frames, at that many pixels across the object."""
        camera = self.capture.filmed[0]
        frames, masks = self.capture.video(camera.name).frames, self.capture.mask(camera.name)
        assert masks is not None
        across = max(np.ptp(np.argwhere(masks[0]), axis=0)) + 1
        return PhotometricObservations.of_video(
            camera, frames, masks[: len(frames)], self.field, scale=min(1.0, pixels / float(across)), exposure=False
        )

    def basis(self, name: str) -> str | WeightField:
        """What `convex_twin` is given."""
        if name == "predicted":
            low, high = self.capture.mesh().bounds  # type: ignore[union-attr]
            return predicted_weights(self.network.skinning_field, origin=(low + high) / 2)
        return name.partition(",")[0]

    def row(self, name: str) -> Row:
        """Weights, their error, and the fit."""
        clock, options = time.process_time(), self.options
        at = self.twin.with_values(NAMES, self.start)
        twin = convex_twin(at, self.field, self.basis(name), weights=options.weights)  # type: ignore[arg-type]
        row = Row(self.name, name, twin.scene.body.space.field.count)
        fits = options.turns if name.endswith("fitted") else 0
        try:
            twin = self._fitted(twin, fits)
            row = replace(row, **self._scores(twin), process_seconds=round(time.process_time() - clock, 1))
            return replace(row, rms_at_truth_m=self._at_truth(twin))
        except ConvergenceError as error:
            return replace(row, failure=str(error))

    def _fitted(self, twin: Twin, turns: int) -> Twin:
        values = self.start
        for number, level in enumerate(self.levels):
            seen = [level.in_frames(self.capture.observed_frames)]
            parameters = [default_parameter(n, start=float(v)) for n, v in zip(NAMES, values, strict=True)]
            last = number == len(self.levels) - 1
            sizes = WeightFitOptions(evaluations=self.options.evaluations)
            twin, found = fit_in_turns(twin, parameters, seen, turns=turns if last else 0, options=sizes)
            values = found.values
        return twin

    def _at_truth(self, twin: Twin) -> float:
        """Rms distance with the true material [m]."""
        names = [*NAMES, "damping_time"]
        moved = twin.with_values(names, np.array([*self.true, self.truth["damping_time"]]))
        return self._distance(moved)

    def _distance(self, twin: Twin) -> float:
        gaps = simulate(twin.scene, twin.timing()).positions(self.rest) - self.positions
        return float(np.sqrt(np.square(gaps).sum(-1).mean()))

    def _scores(self, twin: Twin) -> dict[str, float]:
        body, seen = twin.scene.body, self.levels[-1]
        moved = torch.as_tensor(simulate(twin.scene, twin.timing()).positions(seen.points))
        count = self.capture.observed_frames
        early, late = seen.in_frames(count), replace(seen, images=seen.images[count:], windows=seen.windows[count:])
        psnr = [_psnr(part, one) for part, one in ((moved[:count], early), (moved[count:], late))]
        return {
            "log10_error": float(np.log10(body.youngs_modulus[0]) - self.true[0]),
            "poisson_error": float(body.poisson_ratio[0] - self.true[1]),
            "observed_psnr": psnr[0],
            "future_psnr": psnr[1],
            "rms_m": self._distance(twin),
        }


def _psnr(positions: torch.Tensor, seen: PhotometricObservations) -> float:
    return float(-10 * np.log10(float(simulation_loss(positions, [replace(seen, robust_scale=np.inf)])) / 3))


def _field(capture: Capture, folder: Path, options: argparse.Namespace) -> ConvexField:
    """The reconstruction's field, made if it is not there."""
    if not (folder / "field.ply").exists():
        sizes = ReconstructOptions(budget=options.budget, steps=options.steps)
        reconstruct(capture.folder, out=folder, options=sizes)
    return read_ply(folder / "field.ply")


def main() -> None:
    """Run all objects and bases, and store the rows as they are finished."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--captures", type=Path, required=True, help="folder of captures")
    parser.add_argument("--truth", type=Path, required=True, help="folder of their truths")
    parser.add_argument("--work", type=Path, default=Path("build/convex_twin_weights"), help="for reconstructions")
    parser.add_argument("--objects", nargs="+", required=True, help="names of the captures")
    parser.add_argument("--bases", nargs="+", default=list(BASES), choices=BASES, help="which weights")
    parser.add_argument("--weights", type=int, default=10, help="M, of those that are not predicted")
    parser.add_argument("--nodes", type=int, default=300, help="most nodes of the mesh that the modes are found on")
    parser.add_argument("--pixels", type=int, nargs="+", default=[32, 64], help="across the object, coarse to fine")
    parser.add_argument("--turns", type=int, default=2, help="fits of θ")
    parser.add_argument("--evaluations", type=int, default=20, help="roll-outs in each of them")
    parser.add_argument("--budget", type=int, default=6000, help="most convexes of a reconstruction")
    parser.add_argument("--steps", type=int, default=150, help="steps of a reconstruction")
    parser.add_argument("--out", type=Path, default=RESULT)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = [Row(**row) for row in json.loads(options.out.read_text())] if options.out.exists() else []
    for name in options.objects:
        left = [basis for basis in options.bases if (name, basis) not in {(row.object, row.basis) for row in rows}]
        case = Case(name, options) if left else None
        for basis in left:
            assert case is not None
            rows.append(case.row(basis))
            print(json.dumps(asdict(rows[-1]), ensure_ascii=False), flush=True)
            options.out.write_text(json.dumps([asdict(row) for row in rows], indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
