"""From a seed and a configuration to a data set: one independent, repeatable task per simulation."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from data_gen.config import GeneratorConfig
from data_gen.dataset import RenderedView, finish_dataset, simulation_folder, write_simulation
from data_gen.degrade import Degradation, draw_degradation, expose, shake, sub_positions
from data_gen.engines import EngineName, run_tasks
from data_gen.render import Renderer
from data_gen.scene import LOOK, Drop, Look, draw_drop, draw_look, split_of, stream, surface_of
from data_gen.simulate import SimulatedDrop, simulate_drop
from physconvex import __version__
from physconvex.errors import ConvergenceError, InputError
from physconvex.video import write_video

__all__ = ["GenerationSummary", "SimulationTask", "generate_dataset", "make_simulation", "render_view"]

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
    """What a task cost [s] by stage, and the failures that preceded it."""

    simulation: int
    failures: tuple[str, ...]
    simulate_seconds: float
    render_seconds: float
    write_seconds: float


@dataclass(frozen=True)
class GenerationSummary:
    """A finished run: simulations made now, found finished before, and failed attempts that were replaced."""

    made: int
    already_there: int
    failed_attempts: int


@cache
def _renderer(width: int, height: int, supersampling: int) -> Renderer:
    """One renderer per process and image size."""
    return Renderer(width, height, supersampling=supersampling)


def render_view(
    drop: SimulatedDrop, look: Look, degradation: Degradation, config: GeneratorConfig, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Images (uint8 [T, H, W, 3]) and object masks (bool [T, H, W]) of one view; the surface must be set."""
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


def make_simulation(task: SimulationTask) -> TaskReport:
    """Simulate, render and write one simulation; failed attempts are replaced by new draws.

    Raises:
        ConvergenceError: as many attempts failed as the configuration allows.
    """
    torch.set_num_threads(1)
    config, failures = task.config, []
    clock = time.perf_counter()
    for attempt in range(config.solver.max_attempts):
        try:
            drop = draw_drop(config, task.seed, task.simulation, attempt)
            rng = stream(task.seed, LOOK, task.simulation, attempt, _SAMPLING)
            simulated = simulate_drop(drop, config, rng)
            break
        except ConvergenceError as error:
            failures.append(f"attempt {attempt}: {error}")
    else:
        raise ConvergenceError(f"simulation {task.simulation}: {'; '.join(failures)}")
    simulate_seconds = time.perf_counter() - clock
    clock = time.perf_counter()
    views = _views(task, attempt, drop, simulated)
    render_seconds = time.perf_counter() - clock
    clock = time.perf_counter()
    write_simulation(task.root, task.simulation, _metadata(task, attempt, drop, simulated), simulated.samples, views)
    return TaskReport(
        task.simulation, tuple(failures), simulate_seconds, render_seconds, time.perf_counter() - clock
    )


def _views(task: SimulationTask, attempt: int, drop: Drop, simulated: SimulatedDrop) -> list[RenderedView]:
    config = task.config
    video = config.video
    renderer = _renderer(video.width, video.height, video.supersampling)
    renderer.set_surface(surface_of(drop, stream(task.seed, LOOK, task.simulation, attempt, _COLORS)))
    views = []
    for number in range(config.camera.views):
        rng = stream(task.seed, LOOK, task.simulation, attempt, number)
        look = draw_look(config, rng, simulated.surface, name="front")
        degradation = draw_degradation(config.degradation, rng, video.crf)
        images, mask = render_view(simulated, look, degradation, config, rng)
        metadata = {
            "camera": look.camera.to_json(),
            "lighting": asdict(look.lighting),
            "floor_tile": look.backdrop.floor_tile,
            "degradation": asdict(degradation),
        }
        views.append(RenderedView(_encode(images, video.fps, degradation.crf), mask, metadata))
    return views


def _metadata(task: SimulationTask, attempt: int, drop: Drop, simulated: SimulatedDrop) -> dict[str, Any]:
    objects, video = task.config.objects, task.config.video
    return {
        "simulation": task.simulation,
        "seed": task.seed,
        "attempt": attempt,
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


def generate_dataset(
    root: str | Path,
    *,
    count: int,
    config: GeneratorConfig,
    seed: int = 0,
    workers: int = 1,
    engine: EngineName = "local",
    on_report: Callable[[TaskReport], None] | None = None,
) -> GenerationSummary:
    """Make (or finish) a data set of `count` simulations.

    The bytes written depend on `config`, `seed` and the simulation's number only, not on workers, engine or earlier
    interruptions. Times go to `timings.jsonl` and failed attempts to `failures.jsonl`, both outside the manifest.

    Raises:
        InputError: the folder holds a data set of another seed or configuration.
        ConvergenceError: one simulation failed in all its attempts.
    """
    root = Path(root)
    if count < 1:
        raise InputError(f"count: got {count}; expected at least 1")
    _claim(root, config, seed)
    todo = [n for n in range(count) if not simulation_folder(root, n).is_dir()]
    tasks = [SimulationTask(root.resolve(), config, seed, n) for n in todo]
    failed = 0
    for report in run_tasks(make_simulation, tasks, workers=workers, engine=engine):
        _append(root / "timings.jsonl", {k: v for k, v in asdict(report).items() if k != "failures"})
        for message in report.failures:
            _append(root / "failures.jsonl", {"simulation": report.simulation, "message": message})
        failed += len(report.failures)
        if on_report is not None:
            on_report(report)
    finish_dataset(root, config.model_dump(mode="json"), seed, __version__)
    return GenerationSummary(len(todo), count - len(todo), failed)


def _claim(root: Path, config: GeneratorConfig, seed: int) -> None:
    """Note whose data set the folder is, or check that it is ours."""
    claim = {"seed": seed, "configuration": config.model_dump(mode="json"), "generator_version": __version__}
    path = root / "generator.json"
    if path.exists():
        found = json.loads(path.read_text())
        different = [key for key in claim if found.get(key) != claim[key]]
        if different:
            raise InputError(
                f"out: {root} was begun with another {', '.join(different)}; expected the same, or a new folder"
            )
        return
    (root / "simulations").mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(claim, indent=1, sort_keys=True), encoding="utf-8")


def _append(path: Path, content: dict[str, Any]) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(content) + "\n")
