"""Speed and memory of the generator: clips per minute, where the time goes, and how it grows.

    python benchmarks/generator.py                     about ten minutes on two cores; let nothing else run
    python benchmarks/generator.py --simulations 2 --quick

Writes benchmarks/results/generator.json. Part 1 makes a data set with worker processes, as the command
`physconvex generate dataset` does, and counts. Part 2 times the stages of single simulations in this process: object,
mesh, simulate, render, encode. Part 3 varies nodes, frames, steps, views and pixels one at a time, on the same drops.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")

import torch

from data_gen import (
    GeneratorConfig,
    WorkerOptions,
    draw_degradation,
    draw_drop,
    draw_look,
    generate_dataset,
    load_config,
    make_mesh,
    prepare_surface,
    random_stream,
    render_view,
    simulate_drop,
)
from physconvex import ConvergenceError, __version__
from physconvex.io import write_video

STAGES = ("object", "mesh", "simulate", "render", "encode")
VARIATIONS: dict[str, tuple[tuple[str, int], ...]] = {
    "nodes": tuple(("solver.target_nodes", n) for n in (250, 500, 1000, 2000)),
    "frames": tuple(("video.frames", n) for n in (12, 24, 48)),
    "steps": tuple(("solver.steps_per_frame", n) for n in (12, 24, 48)),
    "views": tuple(("camera.views", n) for n in (1, 3, 6)),
    "pixels": tuple(("pixels", n) for n in (64, 128, 256, 448)),
}


class Clock:
    """Seconds spent in each stage."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] += time.perf_counter() - start


def timed_simulation(config: GeneratorConfig, seed: int, number: int) -> dict[str, float] | None:
    """Seconds by stage of one simulation with all its views, and its nodes; None if it failed."""
    clock, rng, video = Clock(), random_stream(seed, 7, number), config.video
    try:
        with clock.stage("object"):
            drop = draw_drop(config, seed, number, 0)
        with clock.stage("mesh"):
            mesh = make_mesh(drop, config.solver, config.motion.gravity)
        with clock.stage("simulate"):
            simulated = simulate_drop(drop, config, rng, mesh=mesh)
    except ConvergenceError:
        return None
    with clock.stage("render"):
        prepare_surface(drop, config, rng)
    for _ in range(config.camera.views):
        with clock.stage("render"):
            look = draw_look(config, rng, simulated.surface, name="front")
            degradation = draw_degradation(config.degradation, rng, video.crf)
            images, _ = render_view(simulated, look, degradation, config, rng)
        with clock.stage("encode"), tempfile.TemporaryDirectory() as folder:
            write_video(Path(folder) / "clip.mp4", images, fps=video.fps, crf=degradation.crf)
    return clock.seconds | {"nodes": float(len(mesh.vertices))}


def medians(config: GeneratorConfig, seed: int, count: int) -> dict[str, float]:
    """Median over `count` drops of each stage, of the total and of the nodes."""
    runs = [run for number in range(count) if (run := timed_simulation(config, seed, 2 * number)) is not None]
    if not runs:
        raise SystemExit("every simulation failed; take another seed")
    for run in runs:
        run["total"] = sum(run[stage] for stage in STAGES)
    return {name: round(statistics.median(run[name] for run in runs), 4) for name in runs[0]} | {"runs": len(runs)}


def varied(overrides: list[str], name: str, value: int) -> GeneratorConfig:
    """The configuration with one setting changed."""
    names = ("video.width", "video.height") if name == "pixels" else (name,)
    return load_config("training", overrides=[*overrides, *(f"{key}={value}" for key in names)])


def throughput(config: GeneratorConfig, seed: int, count: int, workers: int) -> dict[str, Any]:
    """Clips per minute of a whole run with worker processes, their start included and without it."""
    stamps: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        summary = generate_dataset(
            folder,
            count=count,
            config=config,
            seed=seed,
            work=WorkerOptions(workers=workers),
            on_report=lambda *_: stamps.append(time.perf_counter() - start),
        )
        total = time.perf_counter() - start
    clips = summary.made * config.camera.views
    return {
        "workers": workers,
        "simulations": summary.made,
        "clips": clips,
        "failed_attempts": summary.failed_attempts,
        "seconds": round(total, 2),
        "seconds_to_first_simulation": round(stamps[0], 2),
        "clips_per_minute": round(60 * clips / total, 2),
        "worker_peak_memory_mib": round(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024),
    }


def main() -> None:
    """Measure and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--simulations", type=int, default=24, help="simulations of the throughput run")
    parser.add_argument("--repeats", type=int, default=5, help="drops per point of the other parts")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--no-growth", action="store_true", help="leave part 3 out")
    parser.add_argument("--quick", action="store_true", help="small images and few nodes, to see that it works")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "generator.json")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    overrides = ["video={frames: 4, width: 64, height: 64}", "solver.steps_per_frame=2"] if arguments.quick else []
    config = load_config("training", overrides=overrides)
    timed_simulation(varied(overrides, "solver.target_nodes", 100), arguments.seed, 0)  # warm up
    result: dict[str, Any] = {
        "command": " ".join(["python", "benchmarks/generator.py", *sys.argv[1:]]),
        "version": __version__,
        "machine": {"cores": os.cpu_count(), "processor": platform.machine(), "python": platform.python_version()},
        "load_average_at_start": os.getloadavg()[0],
        "configuration": config.model_dump(mode="json"),
        "throughput": throughput(config, arguments.seed, arguments.simulations, arguments.workers),
        "stages_seconds_per_simulation": medians(config, arguments.seed, arguments.repeats),
        "growth": {},
    }
    for label, points in ({} if arguments.no_growth else VARIATIONS).items():
        chosen = points[:2] if arguments.quick else points
        result["growth"][label] = [
            {label: value} | medians(varied(overrides, name, value), arguments.seed, arguments.repeats)
            for name, value in chosen
        ]
        print(label, json.dumps(result["growth"][label]), flush=True)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result["throughput"]), json.dumps(result["stages_seconds_per_simulation"]), sep="\n")


if __name__ == "__main__":
    main()
