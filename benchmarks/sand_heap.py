"""Heaps of loose sand: cylinders that collapse on a rough floor, beside what columns of real grains do.

python benchmarks/sand_heap.py

Radius 0.1 m, internal friction 30°, one second. Published, for heights of a radii, whatever the grains and the floor:
run-out 1.24 a radii for a < 1.7 and 1.6 √a above; height a radii for a < 1, 0.88 a^(1/6) above 1.7, as it is here taken
from 1 on (Lube, Huppert, Sparks & Hallworth 2004, J. Fluid Mech. 508, 175-199).
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import trimesh

from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody
from physconvex.materials import Sand
from physconvex.mesh import tetrahedralize
from physconvex.reduced import BodySamples, ReducedBody, ReducedScene, ReducedSpace, eigenmode_weights

RESULT = Path(__file__).parent / "results" / "sand_heap.json"
RADIUS, ANGLE, FPS = 0.1, 30.0, 24.0


@dataclass(frozen=True)
class Row:
    """One column; lengths in radii.

    Attributes:
        aspect: height of the column.
        weights: M.
        run_out: how far the sand came beyond its radius: 95 % of the nodes lie within.
        height: of the heap.
        published_run_out, published_height: of real grains.
        speed: the fastest node's over the last frame [m/s].
        top_speed: the fastest node's ever.
        seconds: processor time.
    """

    aspect: float
    weights: int
    run_out: float
    height: float
    published_run_out: float
    published_height: float
    speed: float
    top_speed: float
    seconds: float


def measure(aspect: float, weights: int) -> Row:
    """Let one column go."""
    clock = time.process_time()
    column = trimesh.creation.cylinder(radius=RADIUS, height=aspect * RADIUS, sections=16)
    vertices = np.asarray(column.vertices) + np.array([0.0, 0.0, 0.5 * aspect * RADIUS])
    mesh = tetrahedralize((vertices, np.asarray(column.faces)), order=2, max_nodes=400, method="auto")
    space = ReducedSpace(eigenmode_weights(ElasticBody(mesh), weights), BodySamples.of_mesh(mesh))
    body = ReducedBody(space, youngs_modulus=1e5, poisson_ratio=0.3, flow=Sand(np.radians(ANGLE)))
    scene = ReducedScene(body, obstacles=(Plane(friction=1.0),))
    run = simulate(scene, Timing(frames=int(FPS), fps=FPS, steps_per_frame=8, tolerance=1e-6))
    positions = run.positions(mesh.vertices)
    speeds = np.linalg.norm(np.diff(positions, axis=0), axis=2).max(axis=1) * FPS
    last = positions[-1]
    distance = np.linalg.norm(last[:, :2] - last[:, :2].mean(axis=0), axis=1)
    return Row(
        aspect,
        weights,
        float(np.quantile(distance, 0.95) / RADIUS - 1),
        float(np.ptp(last[:, 2]) / RADIUS),
        1.24 * aspect if aspect < 1.7 else 1.6 * aspect**0.5,
        aspect if aspect < 1 else 0.88 * aspect ** (1 / 6),
        float(speeds[-1]),
        float(speeds.max()),
        time.process_time() - clock,
    )


def main() -> None:
    """Measure, print, store."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    rows = []
    for aspect in (0.5, 1.0, 2.0):
        for weights in (12, 20):
            rows.append(measure(aspect, weights))
            print(rows[-1], flush=True)
    stored = {"command": "python benchmarks/sand_heap.py", "rows": [asdict(row) for row in rows]}
    RESULT.write_text(json.dumps(stored, indent=1) + "\n")


if __name__ == "__main__":
    main()
