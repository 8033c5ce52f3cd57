"""Identification, dynamic reconstruction, future prediction and generalisation of every object of a benchmark.

All but the column with the given mesh works from the images of the capture. Each part of an object is stored when it is
finished (`OUT/objects/NAME.json`), so that an evaluation can be stopped.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import cast

import numpy as np

from data_gen import changed, changes_of
from inference import Refinement, RefineOptions, predict, reconstruct, refine, with_rest_geometry
from physconvex import ConvergenceError, InputError
from physconvex.convex import ConvexField, bind_to_tets, read_ply
from physconvex.dynamics import simulate
from physconvex.fem import SurfacePoints
from physconvex.identify import FullModel, TwinOptions, base_twin
from physconvex.io import Camera, Capture, load_capture, read_mesh, write_json
from physconvex.mesh import Embedding, TetMesh
from train.options import PaperOptions
from train.paper.pictures import score_pictures
from train.paper.published_way import NAMES, WAYS, PublishedFit, PublishedOptions, fit_as_published
from train.paper.rows import Change, ObjectRow, PaperPart, PictureScores

CONSTANT = (5.5, 0.345)  # the middle of the ranges 1e4 to 1e7 Pa and .2 to .49
POINTS = 6  # per convex, of the main columns
MAIN = ("reconstruction", "constant", "network", "convex_twin", "corrected", "followed", "given_mesh")
VIEWS = 4  # whose pictures are scored: the front one, and others evenly around the object


def evaluate_paper(
    benchmark: Path,
    out: Path,
    options: PaperOptions | None = None,
    *,
    names: Sequence[str] | None = None,
    parts: Sequence[str] | None = None,
    comparisons: bool = True,
    on_part: Callable[[str, str], None] | None = None,
) -> list[ObjectRow]:
    """Evaluate (or continue with) all objects with an existing truth.

    Args:
        benchmark: folder of `physconvex generate benchmark`, which may still be running.
        out: folder of the results.
        options: sizes.
        names: of the objects to evaluate; None: all. The result includes other objects as far as they are evaluated.
        parts: the parts to compute now, such as "convex_twin"; None: all. What they need is computed with them.
        comparisons: also the published method and the parts over M and K, after everything else, if `parts` is None.
        on_part: called with the object and the part at its start.

    Returns:
        Content of `OUT/objects/NAME.json`.

    Raises:
        InputError: no benchmark, an unknown name or part, or `out` holds an evaluation with other options.
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
    compared = _comparisons(options)
    known = (*MAIN, *compared)
    unknown = sorted(set(parts or ()) - set(known))
    if unknown:
        raise InputError(f"parts: {', '.join(unknown)}: unknown; expected some of {', '.join(known)}")
    made = [name for name in names or every if (benchmark / "truth" / name / "truth.json").exists()]
    for group in (MAIN, compared if comparisons or parts else ()):  # first the main tables, for all objects
        wanted = [part for part in group if parts is None or part in parts]
        for name in made if wanted else ():
            _Object(benchmark, out, name, options, on_part).evaluate(wanted)
    files = [out / "objects" / f"{name}.json" for name in every]
    return [ObjectRow.read(file) for file in files if file.exists()]


def _claim(file: Path, options: PaperOptions) -> None:
    """Write the settings that results depend on; the choice of parts may differ in every run."""
    settings = options.to_json()
    for choice in ("ablation", "ablation_points", *(() if options.adam_steps else ("adam_steps", "adam_scale"))):
        del settings[choice]
    held = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    others = [name for name, value in settings.items() if held.get(name, value) != value]
    if others:
        raise InputError(
            f"{file.parent}: holds an evaluation with other options ({', '.join(others)}); choose another folder"
        )
    if held != held | settings:
        write_json(file, held | settings)


def _comparisons(options: PaperOptions) -> tuple[str, ...]:
    """Names of the parts that compare: the published way and its variants, the numbers K of points and M of weights."""
    points = dict.fromkeys(points for points, _ in options.pairs if points != POINTS)
    ways = WAYS if options.adam_steps else ()
    return (*ways, *(f"reconstruction_K{k}" for k in points), *(f"convex_K{k}_M{m}" for k, m in options.pairs))


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
        self.truth = benchmark / "truth" / name
        self.work, self.file = out / "work" / name, out / "objects" / f"{name}.json"
        self.true = json.loads((self.truth / "truth.json").read_text(encoding="utf-8"))
        cameras = [Camera.from_json(c) for c in json.loads((self.truth / "cameras.json").read_text("utf-8"))]
        self.cameras = [cameras[k] for k in sorted({k * len(cameras) // VIEWS for k in range(VIEWS)})]
        self.corrected: Refinement | None = None
        self.aside = np.zeros(2)
        self.row = ObjectRow.read(self.file) if self.file.exists() else ObjectRow(name)

    def evaluate(self, parts: Sequence[str]) -> None:
        self.row.truth = {name: self._true(name) for name in NAMES}
        self.row.truth_itself = self._truth_itself()
        self.row.write(self.file)
        for part in parts:
            for needed in ("network", part) if part in WAYS else (part,):  # its start is the prediction
                self._part(needed, self._known[needed])

    @property
    def _known(self) -> dict[str, Callable[[], PaperPart]]:
        """How each part is computed."""
        options, front = self.options, self.cameras[:1]
        return {
            "reconstruction": partial(self._reconstruction, POINTS),
            "constant": self._constant,
            "network": self._network,
            "convex_twin": partial(self._convex_twin, POINTS, options.weights, self.cameras),
            "corrected": self._corrected,
            "followed": self._followed,
            "given_mesh": self._given_mesh,
            **{way: partial(self._published_way, way) for way in WAYS},
            **{f"reconstruction_K{k}": partial(self._reconstruction, k) for k, _ in options.pairs},
            **{f"convex_K{k}_M{m}": partial(self._convex_twin, k, m, front) for k, m in options.pairs},
        }

    def _part(self, part: str, compute: Callable[[], PaperPart]) -> None:
        if part in self.row.parts:
            return
        if self.on_part is not None:
            self.on_part(self.name, part)
        start, self.aside = _clock(), np.zeros(2)
        try:
            found = compute()
        except (ConvergenceError, InputError) as error:  # a failure is a result here, with its reason
            found = PaperPart(failure=f"{type(error).__name__}: {error}")
        spent = _clock() - start - self.aside
        found["process_seconds"], found["seconds"] = (round(float(t), 1) for t in spent)
        self.row.parts[part] = found
        self.row.write(self.file)

    @contextmanager
    def _scoring(self) -> Iterator[None]:
        """What is done inside does not count as time of the part."""
        start = _clock()
        try:
            yield
        finally:
            self.aside = self.aside + _clock() - start

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

    # -- the body from images, and models on it

    def _settings(self, points: int = POINTS) -> RefineOptions:
        options = self.options
        return RefineOptions(
            observations="video",
            weights=options.weights,
            max_nodes=options.max_nodes,
            fine_nodes=options.fine_nodes,
            steps_per_frame=options.steps_per_frame,
            full_runs=options.full_runs,
            model_error=options.model_error,
            field_budget=options.field_budget,
            field_steps=options.field_steps,
            field_points=points,
            checkpoint=options.checkpoint,
        )

    def _folder(self, points: int) -> Path:
        """Of the refinements from images, which share one reconstruction."""
        return self.work / f"K{points}"

    @cached_property
    def _body(self) -> Capture:
        """The capture with the reconstructed body."""
        return with_rest_geometry(self.capture, out=self._folder(POINTS), options=self._settings().reconstruction)

    @cached_property
    def _field(self) -> ConvexField:
        return read_ply(self._folder(POINTS) / "reconstruction" / "field.ply")

    def _full_model(self, names: tuple[str, ...], mesh: TetMesh | None = None) -> FullModel:
        """The full-order model of the reconstructed body, at the points whose true motion is known."""
        options = self.options
        sizes = TwinOptions(max_nodes=options.max_nodes, steps_per_frame=options.steps_per_frame, fill=True)
        twin = base_twin(self._body, sizes)
        surface = SurfacePoints.of_triangles(*twin.surface) if twin.scene.obstacles else None
        with np.load(self.truth / "points.npz") as arrays:
            return FullModel(twin, names, arrays["rest"], self.capture.frames, mesh, surface=surface)

    # -- parts

    def _reconstruction(self, points: int) -> PaperPart:
        options = self._settings(points).reconstruction
        found = reconstruct(self.capture.folder, out=self._folder(points) / "reconstruction", options=options)
        means = [float(np.mean([getattr(score, name) for score in found.training])) for name in ("psnr", "ssim")]
        out = PaperPart(convexes=len(found.field), first_images=PictureScores(psnr=means[0], ssim=means[1]))
        if found.body is not None:
            true = read_mesh(self.truth / "mesh.ply")
            out["volume_error"] = float(found.body.volume / true.volume - 1)
        return out

    def _constant(self) -> PaperPart:
        return self._stated(np.array(CONSTANT))

    def _network(self) -> PaperPart:
        found = predict(self.capture.folder, checkpoint=self.options.checkpoint)
        return self._stated(np.array([np.log10(found.youngs_modulus), found.poisson_ratio]))

    def _stated(self, values: np.ndarray) -> PaperPart:
        """Values that are fitted to nothing, and the full-order model's motion with them."""
        out = self._errors(values)
        with self._scoring():
            model = self._full_model(NAMES)
            out |= self._motion(model.rolled_mesh, model.node_positions(values), self._field, self.cameras)
        return out

    def _corrected(self) -> PaperPart:
        found = self._corrected_fit()
        out = self._fitted(found, self.cameras)
        out["reduced_model_rms_m"] = list(found.motion.reduced_gap)
        with self._scoring():
            out["changes"] = self._changes(found)
        return out

    def _corrected_fit(self) -> Refinement:
        if self.corrected is None:
            self.corrected = refine(self.capture.folder, out=self._folder(POINTS), options=self._settings())
        return self.corrected

    def _followed(self) -> PaperPart:
        """The same with the rigid drift after the contact."""
        found = self._corrected_fit()
        motion = found.followed or found.motion
        out = PaperPart(drift=found.drift.to_json() if found.drift else None)
        with self._scoring():
            out |= self._motion(motion.mesh, motion.nodes, self._field, self.cameras)
        return out

    def _given_mesh(self) -> PaperPart:
        """The same with the true surface."""
        options = self._settings().replace(body=self.truth / "mesh.ply")
        return self._fitted(refine(self.capture.folder, out=self.work / "given_mesh", options=options), self.cameras)

    def _convex_twin(self, points: int, weights: int, cameras: Sequence[Camera]) -> PaperPart:
        """The convex twin alone, with so many points per convex and skinning weights."""
        settings = self._settings(points).replace(weights=weights, stop_after="convex")
        return self._fitted(refine(self.capture.folder, out=self._folder(points), options=settings), cameras)

    def _published_way(self, way: str) -> PaperPart:
        """From the network's prediction; perhaps with this project's time steps or optimiser in place of theirs."""
        network = self.row.parts["network"]
        start = np.array(network["values"] if "values" in network else CONSTANT)
        chosen, options = PublishedOptions.of_way(way), self.options
        settings = replace(chosen, steps=options.adam_steps, scale=options.adam_scale, max_nodes=options.max_nodes)
        found = fit_as_published(self._body, self._field, start, options=settings, out=self.work / way)
        out = self._errors(found.values)
        out["losses"], out["steps"] = found.losses.tolist(), len(found.losses)
        with self._scoring():
            out |= self._convexes(found)
        return out

    def _convexes(self, found: PublishedFit) -> PaperPart:
        """Distance of the surface from the truth; scores of the pictures of the convexes, which are the body."""
        with np.load(self.truth / "points.npz") as arrays:
            gaps = found.trajectory.positions(arrays["rest"]) - arrays["positions"]
        return PaperPart(
            rms_m=np.sqrt(np.square(gaps).sum(-1).mean(-1)).tolist(),
            convexes=len(found.field),
            pictures=self._pictures(found.fields, self.cameras),
        )

    # -- scores

    def _fitted(self, found: Refinement, cameras: Sequence[Camera]) -> PaperPart:
        """Estimates with their intervals, and the scores of the motion."""
        estimates = [found[name] for name in NAMES]
        wanted = [self._true(name) for name in NAMES]
        intervals = [e.interval for e in estimates]
        out = self._errors(np.array([e.value for e in estimates]))
        out["intervals_90"] = [None if i is None else list(i) for i in intervals]
        out["covered"] = [
            None if i is None else bool(i[0] <= w <= i[1]) for i, w in zip(intervals, wanted, strict=True)
        ]
        out["in_words"] = [*found.identifiability.sentences, *found.warnings]
        field = None if found.appearance is None else found.appearance.field
        with self._scoring():
            out |= self._motion(found.motion.mesh, found.motion.nodes, field, cameras)
        return out

    def _motion(
        self, mesh: TetMesh, nodes: np.ndarray, field: ConvexField | None, cameras: Sequence[Camera]
    ) -> PaperPart:
        """Distance of the surface from the truth; scores of the pictures, observed and future, with a field on it."""
        with np.load(self.truth / "points.npz") as arrays:
            gaps = Embedding.of_points(mesh, arrays["rest"]).apply(nodes) - arrays["positions"]
        out = PaperPart(rms_m=np.sqrt(np.square(gaps).sum(-1).mean(-1)).tolist())
        if field is not None:
            bound = bind_to_tets(field, mesh)
            out["convexes"] = len(field)
            out["pictures"] = self._pictures(lambda frames: [bound.at(nodes[t]) for t in frames], cameras)
        return out

    def _pictures(
        self, moved: Callable[[range], list[ConvexField]], cameras: Sequence[Camera]
    ) -> dict[str, dict[str, PictureScores]]:
        """Scores of a moved field, observed and future."""
        seen = self.capture.observed_frames
        parts = {"observed": range(0, seen), "future": range(seen, self.capture.frames)}
        return {
            label: score_pictures(moved(frames), cameras, self.truth, frames)
            for label, frames in parts.items()
            if len(frames)
        }

    def _changes(self, found: Refinement) -> dict[str, Change]:
        """Rms distance [m] from the truth under the same change, and the distance that the change moves the truth."""
        model = self._full_model(tuple(e.name for e in found.estimates), found.motion.mesh)
        usual = model.roll_out(np.array([e.value for e in found.estimates]))
        points = Embedding.of_points(found.motion.mesh, model.points)
        out = {}
        with np.load(self.truth / "points.npz") as arrays:
            for change in [name for name in changes_of(usual.scene) if f"positions_{name}" in arrays]:
                run = simulate(changed(usual.scene, change), usual.timing)
                gap = points.apply(run.positions) - arrays[f"positions_{change}"]
                moved = arrays[f"positions_{change}"] - arrays["positions"]
                distances = [float(np.sqrt(np.square(way).sum(-1).mean())) for way in (gap, moved)]
                out[change] = Change(rms_m=distances[0], change_rms_m=distances[1])
        return out


def _clock() -> np.ndarray:
    """Processor time and wall-clock time [s]."""
    return np.array([time.process_time(), time.perf_counter()])
