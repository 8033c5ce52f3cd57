"""Cost of the full-order model's parts on one core by two arithmetics, side by side.

python benchmarks/full_order_speed.py

A cube of quadratic tetrahedra dropped on a tilted, rough floor, 12 frames of 8 steps. "Plain" is the arithmetic that
every law has, and solves that are refined twice, which is what Pardiso does unless its settings are given; "compiled"
the usual one of the neo-Hookean laws.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from reduced_speed import milliseconds, seconds

from physconvex.dynamics import ContactSolver, Plane, State, Timing, implicit_euler, simulate
from physconvex.fem import ElasticBody, NodalEquations, Scene
from physconvex.mesh import box_mesh
from physconvex.numerics import sparse_solvers as linear_solvers

RESULT = Path(__file__).parent / "results" / "full_order_speed.json"
STEP = 1 / 400


@dataclass(frozen=True)
class Row:
    """Processor times.

    Attributes:
        nodes: of the mesh.
        damping_time: of the body [s].
        arithmetic: "plain" or "compiled".
        evaluate, factorise, solve: energy and gradient; stiffness and its factor; one right-hand side [ms].
        passes, condensed: the roll-out with either contact solver [s].
    """

    nodes: int
    damping_time: float
    arithmetic: str
    evaluate: float
    factorise: float
    solve: float
    passes: float
    condensed: float


def measure(cells: int, damping_time: float, arithmetic: str) -> Row:
    """One mesh, with one arithmetic."""
    fast = arithmetic != "plain"
    body = ElasticBody(box_mesh((0.12,) * 3, (cells,) * 3), youngs_modulus=5e4, poisson_ratio=0.4)
    body._quick = body._quick if fast else None
    linear_solvers._SETTINGS[8] = 0 if fast else 2
    floor = Plane(point=(0, 0, -0.13), normal=(0.1, 0.05, 1.0), friction=0.3)
    scene = Scene(body, obstacles=(floor,), damping_time=damping_time)
    x = body.mesh.vertices
    equations, still = NodalEquations(scene), State(0.0, x, np.zeros_like(x))
    equations.set_step(implicit_euler(still, STEP), STEP, x, still)
    force = equations.gradient(x)

    def rolled_out(solver: ContactSolver) -> float:
        timing = Timing(frames=12, fps=50, steps_per_frame=8, contact_solver=solver)
        return seconds(lambda: simulate(scene, timing))

    return Row(
        len(x),
        damping_time,
        arithmetic,
        factorise=milliseconds(lambda: equations.factorise(x, project=False), 6),
        evaluate=milliseconds(lambda: equations.evaluate(x), 20),
        solve=milliseconds(lambda: equations.solve(force), 20),
        passes=rolled_out("passes"),
        condensed=rolled_out("condensed"),
    )


def main() -> None:
    """Run all settings and store the table."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    torch.set_num_threads(1)
    rows = []
    for cells, damping_time in ((4, 0.0), (4, 3e-3), (6, 0.0)):
        for arithmetic in ("plain", "compiled"):
            rows.append(measure(cells, damping_time, arithmetic))
            print(rows[-1], flush=True)
    content = {"command": "python benchmarks/full_order_speed.py", "rows": [asdict(row) for row in rows]}
    RESULT.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
