"""The motion of a body of finite elements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import SolveStatistics


@dataclass(frozen=True)
class Trajectory:
    """States at the frames: times [T] s, positions [T, V, 3] m and velocities [T, V, 3] m/s of the nodes, and cost."""

    times: Float[np.ndarray, " T"]
    positions: Float[np.ndarray, "T V 3"]
    velocities: Float[np.ndarray, "T V 3"]
    statistics: SolveStatistics
