"""Obstacles in the format of the compiled kernels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from physconvex.dynamics.contact import Obstacle, Plane, Sphere


def obstacle_rows(obstacles: Sequence[Obstacle], time: float) -> Float[np.ndarray, "O 9"]:
    """`struct Obstacle` of cpu/obstacle.h of each obstacle at a time [s]."""
    return np.array([_row(obstacle, time) for obstacle in obstacles]).reshape(-1, 9)


def _row(obstacle: Obstacle, time: float) -> list[float]:
    if isinstance(obstacle, Plane):
        where, size = obstacle.normal, -float(obstacle.gap(np.zeros((1, 3)), time)[0])
    else:
        where, size = obstacle.center_at(time), obstacle.radius
    return [float(isinstance(obstacle, Sphere)), *where, size, *obstacle.velocity_at(time), obstacle.friction]
