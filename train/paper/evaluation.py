"""Identification, dynamic reconstruction, future prediction and generalisation of every object of a benchmark.

Each part of an object is stored when it is finished (`OUT/objects/NAME.json`), so that an evaluation can be stopped.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from data_gen import changed, changes_of
from inference import ReconstructOptions, Refinement, RefineOptions, predict, reconstruct, refine
from physconvex import ConvergenceError, InputError
from physconvex.convex import ConvexField, bind_to_tets, read_ply
from physconvex.dynamics import simulate
from physconvex.fem import SurfacePoints
from physconvex.identify import FullModel, TwinOptions, base_twin
from physconvex.io import Camera, Capture, load_capture
from physconvex.mesh import Embedding, TetMesh
from physconvex.reconstruction import ReconstructionConfig
from train.options import PaperOptions
from train.paper.pictures import score_pictures
from train.paper.published_way import NAMES, fit_as_published
from train.paper.rows import Change, ObjectRow, PaperPart, PictureScores

CONSTANT = (5.5, 0.345)  # the middle of the ranges 1e4 to 1e7 Pa and .2 to .49


def evaluate_paper(
    benchmark: Path,
    out: Path,
    options: PaperOptions | None = None,
    *,
    names: Sequence[str] | None = None,
    comparisons: bool = True,
    on_part: Callable[[str, str], None] | None = None,
) -> list[ObjectRow]:
    """Evaluate (or continue with) all objects with an existing truth.

    Args:
        benchmark: folder of `physconvex generate benchmark`, which may still be running.
        out: folder of the results.
        options: sizes.
        names: of the objects to evaluate; None: all. The result includes other objects as far as they are evaluated.
        comparisons: also the published method and the parts over M and K, after everything else.
        on_part: called with the object and the part at its start.

    Returns:
        Content of `OUT/objects/NAME.json`.

    Raises:
        InputError: no benchmark, an unknown name, or `out` holds an evaluation with other options.
    """
    options = options or PaperOptions()
    claim = benchmark / "benchmark.json"
    if not claim.exists():
        raise InputError(f"{benchmark}: no benchmark.json; make one with `physconvex generate benchmark`")
    every = list(json.loads(claim.read_text(encoding="utf-8"))["objects"])
    unknown = sorted(set(names or ()) - set(every))
    if unknown:
        raise InputError(f"objects: {', '.join(unknown)}: not in {benchmark}; expected some of {', '.join(every)}")
    (out / "objects").mkdir(parents=True, exist_ok=True)
    _claim(out / "options.json", options)
    made = [name for name in names or every if (benchmark / "truth" / name / "truth.json").exists()]
    for comparing in (False, True) if comparisons else (False,):  # first the main tables, for all objects
        for name in made:
            _Object(benchmark, out, name, options, on_part).evaluate(comparing)
    files = [out / "objects" / f"{name}.json" for name in every]
    return [ObjectRow.read(file) for file in files if file.exists()]


def _claim(file: Path, options: PaperOptions) -> None:
    """Write the settings that results depend on; the choice of parts may differ in every run."""
    settings = options.to_json()
    for choice in ("ablation", "ablation_points", *(() if options.adam_steps else ("adam_steps",))):
        del settings[choice]
    held = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    others = [name for name, value in settings.items() if held.get(name, value) != value]
    if others:
        raise InputError(
            f"{file.parent}: holds an evaluation with other options ({', '.join(others)}); choose another folder"
        )
    file.write_text(json.dumps(held | settings, indent=1) + "\n", encoding="utf-8")


class _Object:
    """One object of the benchmark."""

    def __init__(
        self,
        benchmark: Path,
        out: Path,
        name: str,
        options: PaperOptions,
        on_part: Callable[[str, str], None] | None,
    ) -> None:
        self.name, self.options, self.on_part = name, options, on_part
        self.capture: Capture = load_capture(benchmark / "captures" / name)
        self.first, self.truth = benchmark / "first_frames" / name, benchmark / "truth" / name
        self.work, self.file = out / "work" / name, out / "objects" / f"{name}.json"
        self.true = json.loads((self.truth / "truth.json").read_text(encoding="utf-8"))
        self.cameras = [Camera.from_json(c) for c in json.loads((self.truth / "cameras.json").read_text("utf-8"))]
        self.refinements: dict[str, Refinement] = {}
        self.row = ObjectRow.read(self.file) if self.file.exists() else ObjectRow(name)

    def evaluate(self, comparing: bool) -> None:
        self.row.truth = {name: self._true(name) for name in NAMES}
        self.row.truth_itself = self._truth_itself()
        self.row.write(self.file)
        for part, compute in self._comparisons() if comparing else self._main():
            self._part(part, compute)

    def _main(self) -> list[tuple[str, Callable[[], PaperPart]]]:
        return [
            ("constant", lambda: self._errors(np.array(CONSTANT))),
            ("network", self._network),
            ("field", self._field),
            ("refined", self._refined),
            ("followed", self._followed),
        ]

    def _comparisons(self) -> list[tuple[str, Callable[[], PaperPart]]]:
        options = self.options
        published = [("published_way", self._published_way)] if options.adam_steps else []
        over_weights = [(f"reduced_M{m}", partial(self._reduced, m)) for m in options.ablation]
        return published + over_weights + [(f"points_K{k}", partial(self._points, k)) for k in options.ablation_points]

    def _part(self, part: str, compute: Callable[[], PaperPart]) -> None:
        if part in self.row.parts:
            return
        if self.on_part is not None:
            self.on_part(self.name, part)
        clock, wall = time.process_time(), time.perf_counter()
        try:
            found = compute()
        except (ConvergenceError, InputError) as error:  # a failure is a result here, with its reason
            found = PaperPart(failure=f"{type(error).__name__}: {error}")
        found["process_seconds"] = round(time.process_time() - clock, 1)
        found["seconds"] = round(time.perf_counter() - wall, 1)
        self.row.parts[part] = found
        self.row.write(self.file)

    def _true(self, name: str) -> float:
        return float(np.log10(self.true["youngs_modulus"])) if name == NAMES[0] else float(self.true[name])

    def _errors(self, values: np.ndarray) -> PaperPart:
        wanted = np.array([self._true(name) for name in NAMES])
        return PaperPart(values=[float(v) for v in values], errors=[float(v) for v in values - wanted])

    def _truth_itself(self) -> PaperPart:
        """The truth's own errors, and its future pictures compared with those of half the nodes."""
        kept = ("nodes", "overlap", "rms_to_half_steps_m", "rms_to_half_nodes_m")
        out = cast(PaperPart, {name: self.true[name] for name in kept if name in self.true})
        future = slice(self.capture.observed_frames, self.capture.frames)
        if "psnr_to_half_nodes" in self.true and self.true["psnr_to_half_nodes"][future]:
            means = [float(np.mean(self.true[f"{n}_to_half_nodes"][future])) for n in ("psnr", "ssim")]
            out["pictures"] = {"future": {"front": PictureScores(psnr=means[0], ssim=means[1])}}
        return out

    # -- parts

    def _network(self) -> PaperPart:
        found = predict(self.capture.folder, checkpoint=self.options.checkpoint)
        return self._errors(np.array([np.log10(found.youngs_modulus), found.poisson_ratio]))

    def _field(self) -> PaperPart:
        options = ReconstructOptions(budget=self.options.field_budget, steps=self.options.field_steps)
        found = reconstruct(self.first, out=self.work / "field", options=options)
        return PaperPart(convexes=len(found.field), psnr=float(np.mean([score.psnr for score in found.training])))

    def _refine(self, options: RefineOptions, name: str) -> Refinement:
        if name not in self.refinements:
            self.refinements[name] = refine(self.capture.folder, out=self.work / name, options=options)
        return self.refinements[name]

    def _settings(self) -> RefineOptions:
        options = self.options
        return RefineOptions(
            observations="video",
            weights=options.weights,
            max_nodes=options.max_nodes,
            fine_nodes=options.fine_nodes,
            steps_per_frame=options.steps_per_frame,
            full_runs=options.full_runs,
            model_error=options.model_error,
            field=False,
            checkpoint=options.checkpoint,
        )

    def _refined(self) -> PaperPart:
        found = self._refine(self._settings(), "refined")
        estimates = [found[name] for name in NAMES]
        wanted = [self._true(name) for name in NAMES]
        intervals = [e.interval for e in estimates]
        out = self._errors(np.array([e.value for e in estimates]))
        out["intervals_90"] = [None if i is None else list(i) for i in intervals]
        out["covered"] = [
            None if i is None else bool(i[0] <= w <= i[1]) for i, w in zip(intervals, wanted, strict=True)
        ]
        out["in_words"] = [*found.identifiability.sentences, *found.warnings]
        out["reduced_model_rms_m"] = list(found.motion.reduced_gap)
        out.update(self._motion(found.motion.mesh, found.motion.nodes))
        out["changes"] = self._changes(found)
        return out

    def _followed(self) -> PaperPart:
        """The same with the rigid drift after the contact."""
        found = self._refine(self._settings(), "refined")
        motion = found.followed or found.motion
        out = PaperPart(drift=found.drift.to_json() if found.drift else None)
        out.update(self._motion(motion.mesh, motion.nodes))
        return out

    def _motion(self, mesh: TetMesh, nodes: np.ndarray) -> PaperPart:
        """Distance of the surface from the truth, and scores of the pictures, observed and future."""
        seen = self.capture.observed_frames
        parts = {"observed": range(0, seen), "future": range(seen, self.capture.frames)}
        with np.load(self.truth / "points.npz") as arrays:
            gaps = Embedding.of_points(mesh, arrays["rest"]).apply(nodes) - arrays["positions"]
        distance = np.sqrt(np.square(gaps).sum(-1).mean(-1))
        out = PaperPart(rms_m=distance.tolist(), pictures={})
        if "failure" in self.row.parts["field"]:
            return out
        field = read_ply(self.work / "field" / "field.ply")
        for label, frames in parts.items():
            if len(frames):
                out["pictures"][label] = self._scores(field, mesh, nodes, frames)
        return out

    def _scores(self, field: ConvexField, mesh: TetMesh, nodes: np.ndarray, frames: range) -> dict[str, PictureScores]:
        """Of the pictures of a field that moves as a mesh does."""
        bound = bind_to_tets(field, mesh)
        return score_pictures([bound.at(nodes[t]) for t in frames], self.cameras, self.truth, frames)

    def _changes(self, found: Refinement) -> dict[str, Change]:
        """Rms distance [m] from the truth under the same change, and the distance that the change moves the truth."""
        options, names = self.options, tuple(e.name for e in found.estimates)
        twin = base_twin(
            self.capture, TwinOptions(max_nodes=options.max_nodes, steps_per_frame=options.steps_per_frame)
        )
        surface = SurfacePoints.of_triangles(*twin.surface) if twin.scene.obstacles else None
        out = {}
        with np.load(self.truth / "points.npz") as arrays:
            model = FullModel(twin, names, arrays["rest"], self.capture.frames, found.motion.mesh, surface=surface)
            usual = model.roll_out(np.array([e.value for e in found.estimates]))
            points = Embedding.of_points(found.motion.mesh, arrays["rest"])
            for change in changes_of(usual.scene):
                run = simulate(changed(usual.scene, change), usual.timing)
                gap = points.apply(run.positions) - arrays[f"positions_{change}"]
                moved = arrays[f"positions_{change}"] - arrays["positions"]
                distances = [float(np.sqrt(np.square(way).sum(-1).mean())) for way in (gap, moved)]
                out[change] = Change(rms_m=distances[0], change_rms_m=distances[1])
        return out

    def _published_way(self) -> PaperPart:
        network = self.row.parts["network"]
        start = np.array(network["values"] if "values" in network else CONSTANT)
        found = fit_as_published(self.capture, start, steps=self.options.adam_steps, max_nodes=self.options.max_nodes)
        out = self._errors(found.values)
        out["misfit"], out["steps"] = found.misfit, found.steps
        out.update(self._motion(found.twin.mesh, found.nodes))
        return out

    def _points(self, count: int) -> PaperPart:
        """A field of K points per convex: its first images, and its pictures in the motions of several models."""
        budget = max(50, self.options.field_budget // 4)
        config = ReconstructionConfig(budget=budget, steps=self.options.field_steps, points_per_convex=count)
        options = ReconstructOptions(config=config)
        found = reconstruct(self.first, out=self.work / f"field_{count}", options=options)
        means = [float(np.mean([getattr(score, name) for score in found.training])) for name in ("psnr", "ssim")]
        motions = {"refined": self._refine(self._settings(), "refined").motion}
        motions |= {f"M{m}": self._reduced_refinement(m).motion for m in self.options.ablation}
        observed = range(0, self.capture.observed_frames)
        return PaperPart(
            convexes=len(found.field),
            first_images=PictureScores(psnr=means[0], ssim=means[1]),
            observed={
                name: self._scores(found.field, motion.mesh, motion.nodes, observed) for name, motion in motions.items()
            },
        )

    def _reduced_refinement(self, weights: int) -> Refinement:
        settings = self._settings().replace(weights=weights, correction=False, model_error=False, colours=False)
        return self._refine(settings, f"reduced_{weights}")

    def _reduced(self, weights: int) -> PaperPart:
        found = self._reduced_refinement(weights)
        return self._errors(np.array([found[name].value for name in NAMES]))
