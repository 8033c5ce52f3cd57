"""How often sand must take its pressure anew within a time step: distance to a much finer run, and its cost.

python benchmarks/sand_passes.py

A block of sand (10°) of 0.3 × 0.2 × 0.1 m with three weights slumps on a rough floor for three frames at 16 per second;
the reference takes 64 steps per frame with four passes.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody
from physconvex.materials import Sand
from physconvex.mesh import box_mesh
from physconvex.reduced import BodySamples, ReducedBody, ReducedScene, ReducedSpace, eigenmode_weights

RESULT = Path(__file__).parent / "results" / "sand_passes.json"


@dataclass(frozen=True)
class Row:
    """Steps per frame and passes: rms distance to the reference [m], Newton iterations, processor time [s]."""

    steps_per_frame: int
    passes: int
    rms: float
    iterations: int
    seconds: float


def slump(scene: ReducedScene, steps: int, passes: int) -> tuple[np.ndarray, int, float]:
    """Positions of the surface samples at the frames [m], iterations, seconds."""
    clock = time.process_time()
    run = simulate(scene, Timing(frames=4, fps=16, steps_per_frame=steps, friction_passes=passes, tolerance=1e-6))
    positions = run.positions(scene.body.space.samples.surface_points)
    return positions, run.statistics.newton_iterations, time.process_time() - clock


def main() -> None:
    """Run all settings and store the table."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    torch.set_num_threads(1)
    mesh = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=2)
    space = ReducedSpace(eigenmode_weights(ElasticBody(mesh), 3), BodySamples.of_mesh(mesh))
    body = ReducedBody(space, youngs_modulus=5e4, poisson_ratio=0.3, flow=Sand(float(np.radians(10.0))))
    scene = ReducedScene(body, obstacles=(Plane(friction=0.4),), damping_time=2e-3)
    reference, _, _ = slump(scene, 64, 4)
    rows = []
    for steps in (8, 16, 32):
        for passes in (1, 2, 4):
            positions, iterations, seconds = slump(scene, steps, passes)
            rms = float(np.sqrt(((positions - reference) ** 2).sum(-1).mean()))
            rows.append(Row(steps, passes, rms, iterations, seconds))
            print(rows[-1], flush=True)
    RESULT.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
