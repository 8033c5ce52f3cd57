"""Captures for refinement: one drop filmed by a ring of cameras, with masks, rest geometry and tracks.

Data that a laboratory would know are in `capture.json` and the files beside it. The true material, damping and the
images' degradations are in `truth.json`, which only evaluations read.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import trimesh
from jaxtyping import Float
from PIL import Image
from pydantic import Field, JsonValue

from data_gen.config import GeneratorConfig, uniform
from data_gen.dataset import write_claim
from data_gen.degrade import draw_degradation
from data_gen.engines import WorkerOptions, run_tasks
from data_gen.generate import (
    GenerationSummary,
    SimulationTask,
    SuccessfulDrop,
    TaskReport,
    check_source,
    prepare_surface,
    render_view,
    simulate_with_replacements,
)
from data_gen.scene import LOOK, Drop, Look, draw_look, random_stream, surface_of
from physconvex import InputError, __version__
from physconvex.io import Capture, Floor, Options, Tracks, save_capture
from physconvex.mesh import linear_part

# Stream numbers below LOOK's key, in addition to those of generate.py.
_RING, _TRACKS = 20_000, 20_001


class RingOptions(Options):
    """Content of a capture besides the videos."""

    observed_frames: int | None = None
    """Frames that may be fitted. Default: two thirds of all."""
    markers: Annotated[int, Field(ge=0)] = 0
    """Number of tracked surface points; 0 omits tracks.npz."""
    marker_noise: Annotated[float, Field(gt=0)] = 1e-3
    """Standard deviation of the noise of tracked coordinates [m]."""


@dataclass(frozen=True)
class CaptureTask(SimulationTask):
    """Capture number `simulation` below `root`."""

    options: RingOptions


def capture_folder(root: Path, simulation: int) -> Path:
    """Folder of capture number `simulation`."""
    return root / f"{simulation:06d}"


def ring_of_looks(
    config: GeneratorConfig, rng: np.random.Generator, path: Float[np.ndarray, "T P 3"]
) -> tuple[Look, ...]:
    """`camera.views` cameras `camera0`, `camera1`, … around the path [m], evenly spread but for `camera.azimuth_deg`.

    All have the same elevation, focal length, light, floor and background.
    """
    camera = config.camera
    level = {name: getattr(camera, name).sample(rng) for name in ("elevation_deg", "field_of_view_deg")}
    fixed = {name: uniform(value, value) for name, value in level.items()}
    config = config.model_copy(update={"camera": camera.model_copy(update=fixed)})
    looks: list[Look] = []
    for k in range(camera.views):
        azimuth = 360.0 * k / camera.views + camera.azimuth_deg.sample(rng)
        look = draw_look(config, rng, path, name=f"camera{k}", azimuth_deg=azimuth)
        looks.append(Look(look.camera, looks[0].lighting, looks[0].backdrop) if looks else look)
    return tuple(looks)


def make_capture(task: CaptureTask) -> TaskReport:
    """Simulate, render and write one capture, unless all attempts fail."""
    clock = time.perf_counter()
    success, failures = simulate_with_replacements(task.config, task.seed, task.simulation)
    simulate_seconds = time.perf_counter() - clock
    if success is None:
        return TaskReport(task.simulation, failures, True, simulate_seconds, 0.0, 0.0)
    clock = time.perf_counter()
    rng, drop, simulated = _stream(task, success, _RING), success.drop, success.simulated
    prepare_surface(drop, task.config, rng)
    looks = ring_of_looks(task.config, rng, simulated.surface)
    videos, masks, degradations = {}, {}, {}
    for look in looks:
        name, degradation = look.camera.name, draw_degradation(task.config.degradation, rng, task.config.video.crf)
        videos[name], masks[name] = render_view(simulated, look, degradation, task.config, rng)
        degradations[name] = asdict(degradation)
    render_seconds = time.perf_counter() - clock
    clock = time.perf_counter()
    save_capture(
        _capture(task, drop, looks),
        videos=videos,
        masks=masks,
        mesh=_rest_mesh(drop, _stream(task, success, _RING)),
        tets=linear_part(simulated.mesh),
        tracks=_tracks(task, success) if task.options.markers else None,
        truth={**_truth(task, success), "degradations": {**degradations}},
        crf=task.config.video.crf,
    )
    write_seconds = time.perf_counter() - clock
    return TaskReport(task.simulation, failures, False, simulate_seconds, render_seconds, write_seconds)


def _capture(task: CaptureTask, drop: Drop, looks: tuple[Look, ...]) -> Capture:
    video, options = task.config.video, task.options
    observed = max(1, 2 * video.frames // 3) if options.observed_frames is None else options.observed_frames
    return Capture(
        folder=capture_folder(task.root, task.simulation),
        fps=video.fps,
        frames=video.frames,
        observed_frames=observed,
        cameras=tuple(look.camera for look in looks),
        gravity=np.array(task.config.motion.gravity),
        density=drop.density,
        floor=Floor(np.zeros(3), np.array([0.0, 0.0, 1.0]), friction=drop.friction),
        initial_velocity=np.array(drop.initial_velocity),
        initial_angular_velocity=np.array(drop.initial_angular_velocity),
    )


def _rest_mesh(drop: Drop, rng: np.random.Generator) -> trimesh.Trimesh:
    """The coloured surface at the start; `rng` in the state after colouring the surface."""
    surface = surface_of(drop, rng)
    if surface.texture is not None:
        visual = trimesh.visual.TextureVisuals(uv=surface.uv, image=Image.fromarray(surface.texture))
        return trimesh.Trimesh(surface.vertices, surface.faces, visual=visual, process=False)
    return trimesh.Trimesh(surface.vertices, surface.faces, vertex_colors=surface.colors, process=False)


def _stream(task: CaptureTask, success: SuccessfulDrop, number: int) -> np.random.Generator:
    return random_stream(task.seed, LOOK, task.simulation, success.attempt, number)


def _tracks(task: CaptureTask, success: SuccessfulDrop) -> Tracks:
    rng = _stream(task, success, _TRACKS)
    surface, options = success.simulated.surface, task.options
    chosen = np.sort(rng.choice(surface.shape[1], min(options.markers, surface.shape[1]), replace=False))
    positions = surface[:, chosen] + rng.normal(scale=options.marker_noise, size=(len(surface), len(chosen), 3))
    rest = success.drop.placed(success.drop.body.vertices)[chosen]
    return Tracks(rest=rest, positions=positions, sigma=np.full(positions.shape[:2], options.marker_noise))


def _truth(task: CaptureTask, success: SuccessfulDrop) -> dict[str, JsonValue]:
    drop = success.drop
    return {
        "youngs_modulus": drop.youngs_modulus,
        "poisson_ratio": drop.poisson_ratio,
        "density": drop.density,
        "law": task.config.material.law,
        "damping_time": drop.damping_time,
        "friction": drop.friction,
        "object_id": drop.object_id,
        "family": drop.family,
        "object_size": drop.size,
        "nodes": len(success.simulated.mesh.vertices),
        "seed": task.seed,
        "simulation": task.simulation,
        "attempt": success.attempt,
        "generator_version": __version__,
        "solver": asdict(success.simulated.statistics),
    }


def generate_captures(
    root: str | Path,
    *,
    count: int,
    config: GeneratorConfig,
    seed: int = 0,
    options: RingOptions | None = None,
    work: WorkerOptions | None = None,
    on_report: Callable[[TaskReport, int], None] | None = None,
) -> GenerationSummary:
    """Make (or continue) `count` captures below `root`, one folder each; the bytes depend only on the arguments.

    Raises:
        InputError: the folder was begun with another seed, configuration or options, or an argument is out of range.
    """
    root, options = Path(root), options or RingOptions()
    frames = config.video.frames
    check_source(config, count)
    if options.observed_frames is not None and not 1 <= options.observed_frames <= frames:
        raise InputError(
            f"observed_frames: got {options.observed_frames}; expected 1 to {frames}, the frames there are"
        )
    configuration = config.model_dump(mode="json") | {"capture": options.to_json()}
    write_claim(root, {"seed": seed, "configuration": configuration, "generator_version": __version__})
    todo = [n for n in range(count) if not capture_folder(root, n).is_dir()]
    tasks = [CaptureTask(root.resolve(), config, seed, n, options) for n in todo]
    failed, given_up = 0, []
    reports = run_tasks(make_capture, tasks, work)
    for done, report in enumerate(reports, start=count - len(todo) + 1):
        failed += len(report.failures)
        if report.given_up:
            given_up.append(report.simulation)
        if on_report is not None:
            on_report(report, done)
    return GenerationSummary(len(todo) - len(given_up), count - len(todo), failed, tuple(sorted(given_up)))
