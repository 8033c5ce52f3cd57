"""What the convex twin is fitted to: followed points, outlines, pixels, each of them left out in turn.

python benchmarks/convex_twin_observations.py --captures BENCHMARK/captures --truth BENCHMARK/truth --objects NAME

Objects of `physconvex generate benchmark`: `physconvex refine CAPTURE --stop-after convex` from images alone, with
`--no-points`, `--no-outlines` or `--no-colours`. For each of them the errors of E and ν, and the rms distance of the
surface from the true motion, observed and future. The first row of an object is the network's answer.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from inference import Refinement, RefineOptions, predict, refine
from physconvex.errors import ConvergenceError, InputError
from physconvex.io import load_capture
from physconvex.mesh import Embedding

RESULT = Path(__file__).parent / "results" / "convex_twin_observations.json"
LEFT_OUT = ("nothing", "points", "outlines", "colours")


@dataclass(frozen=True)
class Row:
    """One choice of observations for one object.

    Attributes:
        object: its name.
        left_out: what is not observed; "everything" is the network's answer.
        log10_error, poisson_error: estimate less truth.
        covered: whether the 90 % interval of E holds the truth; None: it says that it does not follow.
        observed_rms_m, future_rms_m: distance of the surface from the true motion [m].
        process_seconds: after the reconstruction [s].
        failure: why there is no answer.
    """

    object: str
    left_out: str
    log10_error: float | None = None
    poisson_error: float | None = None
    covered: bool | None = None
    observed_rms_m: float | None = None
    future_rms_m: float | None = None
    process_seconds: float = 0.0
    failure: str | None = None


class Case:
    """One object of a benchmark."""

    def __init__(self, name: str, options: argparse.Namespace) -> None:
        self.name, self.capture, self.work = name, options.captures / name, options.work / name
        self.options, self.truth = options, options.truth / name
        true = json.loads((self.truth / "truth.json").read_text(encoding="utf-8"))
        self.true = np.array([np.log10(true["youngs_modulus"]), true["poisson_ratio"]])

    def row(self, left_out: str) -> Row:
        """The twin's answer without these observations."""
        if left_out == "everything":
            found = predict(self.capture)
            errors = np.array([np.log10(found.youngs_modulus), found.poisson_ratio]) - self.true
            return Row(self.name, left_out, *map(float, errors))
        out, shared = self.work / left_out, self.work / LEFT_OUT[0] / "reconstruction"
        if shared.exists() and not (out / "reconstruction").exists():
            shutil.copytree(shared, out / "reconstruction")
        sizes = {"field_budget": self.options.budget, "field_steps": self.options.steps}
        seen = {name: name != left_out for name in LEFT_OUT[1:]}
        options = RefineOptions(observations="video", stop_after="convex", **sizes, **seen)
        clock = time.process_time()
        try:
            found = refine(self.capture, out=out, options=options)
        except (ConvergenceError, InputError) as error:
            return Row(self.name, left_out, failure=str(error))
        return self._scored(left_out, found, time.process_time() - clock)

    def _scored(self, left_out: str, found: Refinement, seconds: float) -> Row:
        estimates = [found["log10_youngs_modulus"], found["poisson_ratio"]]
        errors = np.array([estimate.value for estimate in estimates]) - self.true
        interval = estimates[0].interval
        covered = None if interval is None else bool(interval[0] <= self.true[0] <= interval[1])
        with np.load(self.truth / "points.npz") as arrays:
            moved = Embedding.of_points(found.motion.mesh, arrays["rest"]).apply(found.motion.nodes)
            squares = np.square(moved - arrays["positions"]).sum(-1).mean(-1)
        seen = load_capture(self.capture).observed_frames
        distances = [float(np.sqrt(part.mean())) for part in (squares[:seen], squares[seen:])]
        return Row(self.name, left_out, *map(float, errors), covered, *distances, round(seconds, 1))


def main() -> None:
    """Run all objects and choices, and store the rows as they are finished."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--captures", type=Path, required=True, help="folder of captures")
    parser.add_argument("--truth", type=Path, required=True, help="folder of their truths")
    parser.add_argument("--work", type=Path, default=Path("build/convex_twin_observations"), help="of the refinements")
    parser.add_argument("--objects", nargs="+", required=True, help="names of the captures")
    parser.add_argument("--budget", type=int, help="most convexes of a reconstruction")
    parser.add_argument("--steps", type=int, help="steps of a reconstruction")
    parser.add_argument("--out", type=Path, default=RESULT)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = [Row(**row) for row in json.loads(options.out.read_text())] if options.out.exists() else []
    done = {(row.object, row.left_out) for row in rows}
    for name in options.objects:
        for left_out in ("everything", *LEFT_OUT):
            if (name, left_out) not in done:
                rows.append(Case(name, options).row(left_out))
                print(json.dumps(asdict(rows[-1]), ensure_ascii=False), flush=True)
                options.out.write_text(json.dumps([asdict(row) for row in rows], indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
