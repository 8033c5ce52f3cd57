"""Contact by passes and condensed, on the same drops of the generator: cost, and what it does to the motion.

Each drop is simulated with contact by passes (friction frozen and solved for in up to twelve passes, steps of equal
length, Newton's tolerance 1e-6), with the generator's settings (condensed), and with these at half the step and a
tolerance of 1e-6, whose distance to them is the error of time. Distances are rms over all nodes, at the frames of the
impact and at the end. Processor time is what counts where other programs run.

    python benchmarks/contact_solvers.py                        goes on where it was
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")

import numpy as np
import torch

from data_gen import SolverConfig, draw_drop, load_config, make_mesh
from physconvex.dynamics import Plane, simulate
from physconvex.fem import ElasticBody, Scene

RESULT = Path(__file__).parent / "results" / "contact_solvers.json"
DROPS = ((4, 5e6), (7, 3e5), (11, 2e4))  # number of the simulation, E [Pa]; those that land soonest
SEED = 11
PASSES = {"contact_solver": "passes", "flight_steps_per_frame": 24, "tolerance": 1e-6}
FINER = {"steps_per_frame": 48, "flight_steps_per_frame": 16, "tolerance": 1e-6}


@dataclass(frozen=True)
class Row:
    """One drop and setting: cost, and rms distance to the run at half the step [mm] by frame."""

    body: str
    nodes: int
    youngs_modulus: float
    settings: str
    processor_seconds: float
    seconds: float
    steps: int
    newton_iterations: int
    factorisations: int
    halved_steps: int
    distance_mm: dict[str, float]


def main() -> None:
    """Run all and store the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=14)
    parser.add_argument("--out", type=Path, default=RESULT)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = known(options.out, options.frames)
    for number, modulus in DROPS:
        if modulus in (row.youngs_modulus for row in rows):
            continue
        rows += compared(number, modulus, options.frames)
        content = {
            "command": " ".join(["python", "benchmarks/contact_solvers.py", *sys.argv[1:]]),
            "frames": options.frames,
            "load_average": os.getloadavg()[0],
            "rows": [asdict(row) for row in rows],
        }
        options.out.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def known(path: Path, frames: int) -> list[Row]:
    """Rows of an earlier run over as many frames; its drops are not run again."""
    tree = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return [Row(**row) for row in tree.get("rows", [])] if tree.get("frames") == frames else []


def scene_of(number: int, modulus: float) -> tuple[str, Scene, SolverConfig]:
    """One drop of the generator: its body's name, the scene, and the generator's settings."""
    config = load_config("training", overrides=[f"material.youngs_modulus={modulus}"])
    drop = draw_drop(config, SEED, number, 0)
    mesh = make_mesh(drop, config.solver, config.motion.gravity)
    body = ElasticBody(mesh, youngs_modulus=modulus, poisson_ratio=drop.poisson_ratio, density=drop.density)
    scene = Scene(
        body,
        obstacles=(Plane(friction=drop.friction),),
        damping_time=drop.damping_time,
        initial_velocity=drop.initial_velocity,
        initial_angular_velocity=drop.initial_angular_velocity,
    )
    return drop.body.name, scene, config.solver


def compared(number: int, modulus: float, frames: int) -> list[Row]:
    """The three runs of one drop."""
    name_of_body, scene, usual = scene_of(number, modulus)
    changes: dict[str, dict[str, Any]] = {"half the step": FINER, "condensed": {}, "passes": PASSES}
    solvers = {name: usual.model_copy(update=change) for name, change in changes.items()}
    rows: list[Row] = []
    best: np.ndarray | None = None
    for name, solver in solvers.items():
        run, cost = timed(scene, solver, frames)
        best = run.positions if best is None else best
        away = np.sqrt(((run.positions - best) ** 2).sum(-1).mean(1))
        distance = {str(k): round(float(1e3 * away[k]), 3) for k in range(1, frames, 2)}
        s = run.statistics
        spent = (s.steps, s.newton_iterations, s.factorisations, s.halved_steps)
        rows.append(Row(name_of_body, len(scene.start), modulus, name, *cost, *spent, distance))
        print(rows[-1], flush=True)
    return rows


def timed(scene: Scene, solver: SolverConfig, frames: int) -> tuple[Any, tuple[float, float]]:
    """A roll-out, and its processor time and time [s]."""
    start = time.process_time(), time.perf_counter()
    run = simulate(scene, solver.timing(frames))
    return run, (round(time.process_time() - start[0], 2), round(time.perf_counter() - start[1], 2))


if __name__ == "__main__":
    main()
