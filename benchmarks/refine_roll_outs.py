"""What the roll-outs are worth that `refine` fits: cost, error, and whether their slopes hold at every scale.

python benchmarks/refine_roll_outs.py --cases 1 3

Thrown blocks of `refine_accuracy.py` at their true parameters. *Steps*: contact by passes and condensed on the first
mesh, beside condensed contact with four times the steps. *Slopes*: by log10 E and ν, over a thousandth and over a tenth
of a typical step. *Meshes*: contact at the nodes and at points all over the surface, beside the finest mesh.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from refine_accuracy import BLOCK, CELLS, FLOOR, FPS, OBSERVED, Throw, throw_of, turned

from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody, Scene, SurfacePoints
from physconvex.mesh import Embedding, TetMesh, refine_uniformly as cut_in_eight, to_quadratic

RESULT = Path(__file__).parent / "results" / "refine_roll_outs.json"
SOLVERS: dict[str, dict[str, Any]] = {
    "passes, three": {"contact_solver": "passes", "friction_passes": 3},
    "passes, twelve": {"contact_solver": "passes", "friction_passes": 12},
    "condensed": {"contact_solver": "condensed"},
}
STEPS, FINEST = 16, (9, 7, 6)
SCALES = {"log10_youngs_modulus": 0.2, "poisson_ratio": 0.1}


def rolled(
    throw: Throw, mesh: TetMesh, points: np.ndarray, *, surface: SurfacePoints | None = None, **options: Any
) -> tuple[np.ndarray, float]:
    """Positions of points [T, P, 3] m, and the processor time [s]."""
    body = ElasticBody(
        mesh, youngs_modulus=10**throw.log10_youngs_modulus, poisson_ratio=throw.poisson_ratio, density=1000.0
    )
    floor = Plane(tuple(FLOOR.point), tuple(FLOOR.normal), friction=FLOOR.friction)
    scene = Scene(
        body,
        obstacles=(floor,),
        damping_time=throw.damping_time,
        initial_velocity=throw.velocity,
        contact_points=surface,
    )
    clock = time.process_time()
    run = simulate(scene, replace(Timing(frames=OBSERVED, fps=FPS, steps_per_frame=STEPS), **options))
    return Embedding.of_points(mesh, points).apply(run.positions), time.process_time() - clock


def rms(difference: np.ndarray) -> float:
    """Of the last frame [mm]."""
    return round(1e3 * float(np.sqrt(np.square(difference[-1]).sum(-1).mean())), 3)


def slopes(
    throw: Throw, mesh: TetMesh, points: np.ndarray, name: str, share: float, options: dict[str, Any]
) -> np.ndarray:
    """Difference of two roll-outs over the change of a parameter by a share of a typical step."""
    change = share * SCALES[name]
    ahead = rolled(throw.moved(name, change), mesh, points, **options)[0]
    return (ahead - rolled(throw, mesh, points, **options)[0]) / change


def measure(case: int) -> dict[str, object]:
    """All three tables of one block."""
    throw = throw_of("block", np.random.default_rng([7, case]))
    block = turned("block", CELLS["block"][0], np.random.default_rng(throw.pose))
    mesh, points = to_quadratic(block), block.vertices
    fine = rolled(throw, mesh, points, steps_per_frame=4 * STEPS, **SOLVERS["condensed"])[0]
    solvers: dict[str, dict[str, object]] = {}
    for label, options in SOLVERS.items():
        at, seconds = rolled(throw, mesh, points, **options)
        rough = {}
        for name in SCALES:
            small, large = (slopes(throw, mesh, points, name, share, options) for share in (1e-3, 1e-1))
            rough[name] = round(float(np.linalg.norm(small - large) / np.linalg.norm(large)), 4)
        twice = rolled(throw, mesh, points, steps_per_frame=2 * STEPS, **options)[0]
        solvers[label] = {
            "seconds": round(seconds, 2),
            "distance_mm": rms(at - fine),
            "distance_with_half_the_step_mm": rms(twice - fine),
            "change_of_slope": rough,
        }
    finest = turned("block", FINEST, np.random.default_rng(throw.pose))
    surface = SurfacePoints.of_triangles(*finest.surface)
    condensed = SOLVERS["condensed"]
    limit = rolled(throw, to_quadratic(finest), points, surface=surface, **condensed)[0]
    meshes: dict[str, dict[str, object]] = {}
    for label, grid in (("first", mesh), ("cut in eight", cut_in_eight(mesh))):
        for where, carried in (("nodes", None), ("surface", SurfacePoints.of_triangles(*block.surface))):
            at, seconds = rolled(throw, grid, points, surface=carried, **condensed)
            meshes[f"{label}, contact at {where}"] = {
                "nodes": len(grid.vertices),
                "seconds": round(seconds, 2),
                "distance_mm": rms(at - limit),
            }
    return {"case": case, "size_m": BLOCK[0], "solvers": solvers, "meshes": meshes}


def main() -> None:
    """Measure, and store the tables after each case."""
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, nargs="+", default=[1, 3])
    rows = []
    for case in parser.parse_args().cases:
        rows.append(measure(case))
        print(json.dumps(rows[-1], indent=1), flush=True)
        content = {"command": "python benchmarks/refine_roll_outs.py", "rows": rows}
        RESULT.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
