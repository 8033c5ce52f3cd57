"""From a seed and a configuration to a data set: one independent, repeatable task per simulation."""

from __future__ import annotations

import json
import logging
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np
from pydantic import JsonValue

from data_gen.config import GeneratorConfig
from data_gen.dataset import RenderedView, finish_dataset, is_settled, write_claim, write_given_up, write_simulation
from data_gen.degrade import Degradation, draw_degradation, expose, shake, sub_positions
from data_gen.engines import WorkerOptions, run_tasks
from data_gen.objects.user_meshes import objects_from_folder
from data_gen.render import Renderer
from data_gen.scene import LOOK, Drop, Look, draw_drop, draw_look, random_stream, split_of, surface_of
from data_gen.simulate import SimulatedDrop, simulate_drop
from physconvex import ConvergenceError, InputError, __version__
from physconvex.io import write_video
from physconvex.numerics import one_torch_thread

_LOG = logging.getLogger("physconvex")

# Stream numbers below LOOK's key that are not views.
_SAMPLING, _COLORS = 10_000, 10_001


@dataclass(frozen=True)
class SimulationTask:
    """Simulation number `simulation` of the data set at `root`."""

    root: Path
    config: GeneratorConfig
    seed: int
    simulation: int


@dataclass(frozen=True)
class TaskReport:
    """Time of a task [s] by stage, its failed attempts, and whether it is abandoned after the last of them."""

    simulation: int
    failures: tuple[str, ...]
    given_up: bool
    simulate_seconds: float
    render_seconds: float
    write_seconds: float


@dataclass(frozen=True, eq=False)
class SuccessfulDrop:
    """A drop that could be simulated, and which attempt it was."""

    attempt: int
    drop: Drop
    simulated: SimulatedDrop


@dataclass(frozen=True)
class GenerationSummary:
    """A finished run: simulations made now, those settled before, failed attempts of this run, and the numbers of the
    simulations that were given up (in this run or before), since all their attempts failed."""

    made: int
    already_there: int
    failed_attempts: int
    given_up: tuple[int, ...]


@cache
def _renderer(width: int, height: int, supersampling: int) -> Renderer:
    """One renderer per process and image size."""
    return Renderer(width, height, supersampling=supersampling)


def prepare_surface(drop: Drop, config: GeneratorConfig, rng: np.random.Generator) -> None:
    """Give the renderer of this process the drop's surface with its colours; `render_view` needs it."""
    video = config.video
    _renderer(video.width, video.height, video.supersampling).set_surface(surface_of(drop, rng))


def render_view(
    drop: SimulatedDrop,
    look: Look,
    degradation: Degradation,
    config: GeneratorConfig,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Images (uint8 [T, H, W, 3]) and object masks (bool [T, H, W]) of one view; call `prepare_surface` first."""
    video = config.video
    renderer = _renderer(video.width, video.height, video.supersampling)
    renderer.set_view(look.camera, look.lighting, look.backdrop)
    images, masks = [], []
    for positions in sub_positions(drop.surface, degradation.shutter, config.degradation.blur_subframes):
        parts = [renderer.frame(p) for p in positions]
        images.append(expose(np.mean([p[0] for p in parts], axis=0), degradation, rng))
        masks.append((np.mean([p[1] for p in parts], axis=0) * 255).astype(np.uint8))
    wander = int(rng.integers(2**31))
    shaken = shake(np.stack(images), degradation, np.random.default_rng(wander))
    covered = shake(np.stack(masks), degradation, np.random.default_rng(wander))
    return shaken, covered > 127


def _encode(frames: np.ndarray, fps: float, crf: int) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "clip.mp4"
        write_video(path, frames, fps=fps, crf=crf)
        return path.read_bytes()


def simulate_with_replacements(
    config: GeneratorConfig, seed: int, simulation: int
) -> tuple[SuccessfulDrop | None, tuple[str, ...]]:
    """The first attempt at a drop that succeeds, if one of `solver.max_attempts` does, and the errors of the others."""
    failures: list[str] = []
    for attempt in range(config.solver.max_attempts):
        try:
            with one_torch_thread():
                drop = draw_drop(config, seed, simulation, attempt)
                simulated = simulate_drop(drop, config, random_stream(seed, LOOK, simulation, attempt, _SAMPLING))
        except ConvergenceError as error:
            failures.append(f"attempt {attempt}: {error}")
        else:
            return SuccessfulDrop(attempt, drop, simulated), tuple(failures)
    return None, tuple(failures)


def make_simulation(task: SimulationTask) -> TaskReport:
    """Simulate, render and write one simulation.

    Failed attempts are recorded and replaced by new draws; after `solver.max_attempts` of them the simulation is
    abandoned.
    """
    clock = time.perf_counter()
    success, failures = simulate_with_replacements(task.config, task.seed, task.simulation)
    simulate_seconds = time.perf_counter() - clock
    if success is None:
        write_given_up(task.root, task.simulation, list(failures))
        return TaskReport(task.simulation, failures, True, simulate_seconds, 0.0, 0.0)
    clock = time.perf_counter()
    views = _views(task, success)
    render_seconds = time.perf_counter() - clock
    clock = time.perf_counter()
    metadata = _metadata(task, success) | {"failures": list(failures)}
    write_simulation(task.root, task.simulation, metadata, success.simulated.samples, views)
    write_seconds = time.perf_counter() - clock
    return TaskReport(task.simulation, failures, False, simulate_seconds, render_seconds, write_seconds)


def _views(task: SimulationTask, success: SuccessfulDrop) -> list[RenderedView]:
    config, attempt, simulated = task.config, success.attempt, success.simulated
    video = config.video
    prepare_surface(success.drop, config, random_stream(task.seed, LOOK, task.simulation, attempt, _COLORS))
    views = []
    for number in range(config.camera.views):
        rng = random_stream(task.seed, LOOK, task.simulation, attempt, number)
        look = draw_look(config, rng, simulated.surface, name="front")
        degradation = draw_degradation(config.degradation, rng, video.crf)
        images, mask = render_view(simulated, look, degradation, config, rng)
        metadata: dict[str, JsonValue] = {
            "camera": look.camera.to_json(),
            "lighting": asdict(look.lighting),
            "floor_tile": look.backdrop.floor_tile,
            "degradation": asdict(degradation),
        }
        views.append(RenderedView(_encode(images, video.fps, degradation.crf), mask, metadata))
    return views


def _metadata(task: SimulationTask, success: SuccessfulDrop) -> dict[str, JsonValue]:
    objects, video, drop, simulated = task.config.objects, task.config.video, success.drop, success.simulated
    return {
        "simulation": task.simulation,
        "seed": task.seed,
        "attempt": success.attempt,
        "generator_version": __version__,
        "object_id": drop.object_id,
        "family": drop.family,
        "split": split_of(drop.object_id, objects.train_share, objects.validation_share),
        "fps": video.fps,
        "frames": video.frames,
        "youngs_modulus": drop.youngs_modulus,
        "poisson_ratio": drop.poisson_ratio,
        "density": drop.density,
        "object_size": drop.size,
        "damping_time": drop.damping_time,
        "friction": drop.friction,
        "drop_height": float(simulated.mesh.vertices[:, 2].min()),
        "initial_velocity": list(map(float, drop.initial_velocity)),
        "initial_angular_velocity": list(map(float, drop.initial_angular_velocity)),
        "nodes": len(simulated.mesh.vertices),
        "volume": simulated.mesh.volume,
        "solver": asdict(simulated.statistics),
    }


def check_source(config: GeneratorConfig, count: int) -> None:
    """Refuse a bad number of simulations, or a folder without objects, before anything is written."""
    if count < 1:
        raise InputError(f"count: got {count}; expected at least 1")
    if config.objects.folder is not None:
        objects_from_folder(config.objects.folder)


def generate_dataset(
    root: str | Path,
    *,
    count: int,
    config: GeneratorConfig,
    seed: int = 0,
    work: WorkerOptions | None = None,
    on_report: Callable[[TaskReport, int], None] | None = None,
) -> GenerationSummary:
    """Make (or continue) a data set of `count` simulations.

    The bytes depend only on `config`, `seed` and the simulation's number, not on `work` (one worker unless given) or
    interruptions. Only times differ; they are in `timings.jsonl`, outside the manifest. `on_report` is called at the
    end of each task, with the number of settled simulations.

    Raises:
        InputError: the folder holds a data set of another seed or configuration, or not one simulation succeeded.
    """
    root = Path(root)
    check_source(config, count)
    write_claim(root, {"seed": seed, "configuration": config.model_dump(mode="json"), "generator_version": __version__})
    todo = [n for n in range(count) if not is_settled(root, n)]
    tasks = [SimulationTask(root.resolve(), config, seed, n) for n in todo]
    failed = made = 0
    reports = run_tasks(make_simulation, tasks, work)
    for done, report in enumerate(reports, start=count - len(todo) + 1):
        with (root / "timings.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps({k: v for k, v in asdict(report).items() if k != "failures"}) + "\n")
        failed += len(report.failures)
        for failure in report.failures:
            _LOG.info("generate: an attempt at simulation %d failed: %s", report.simulation, failure)
        made += not report.given_up
        if on_report is not None:
            on_report(report, done)
    given_up = finish_dataset(root, config.model_dump(mode="json"), seed, __version__)
    return GenerationSummary(made, count - len(todo), failed, given_up)
