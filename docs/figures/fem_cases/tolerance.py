"""What the tolerance of Newton's method costs in accuracy over a second of free flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physconvex.dynamics import Timing, simulate
from physconvex.fem import ElasticBody, Scene
from physconvex.mesh import box_mesh

__all__ = ["Tolerance", "flight"]


@dataclass(frozen=True)
class Tolerance:
    """Largest distance to the run with tolerance 1e-11 over 24 frames [m] (body of 0.3 m), and the cost."""

    youngs_modulus: float
    tolerance: float
    largest: float
    newton_iterations: int
    halved_steps: int


def flight(youngs_modulus: float, tolerances: Sequence[float]) -> list[Tolerance]:
    """A block that falls and spins at (1, 2, 3) rad/s, 384 steps per second."""
    body = ElasticBody(box_mesh((0.3, 0.2, 0.1), (2, 1, 1)), youngs_modulus=youngs_modulus)
    scene = Scene(body, initial_angular_velocity=(1.0, 2.0, 3.0))
    exact = simulate(scene, Timing(tolerance=1e-11)).positions
    rows = []
    for tolerance in tolerances:
        run = simulate(scene, Timing(tolerance=tolerance))
        largest = float(np.linalg.norm(run.positions - exact, axis=2).max())
        cost = run.statistics
        rows.append(Tolerance(youngs_modulus, tolerance, largest, cost.newton_iterations, cost.halved_steps))
    return rows
