"""The motion of one reduced body, or of several."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import SolveStatistics
from physconvex.reduced.space import ReducedSpace


@dataclass(frozen=True)
class ReducedTrajectory:
    """States at the frames.

    Attributes:
        space: the reduced space the coordinates belong to.
        times: [s], shape [T].
        coordinates: y [m], shape [T, R, 3].
        velocities: ẏ [m/s], shape [T, R, 3].
        statistics: cost of the roll-out.
        flowed: F_f at the interior samples, shape [T, Q, 3, 3], of `Flows` [T, Q, 2, 3, 3]; None for
            an elastic body.
    """

    space: ReducedSpace
    times: Float[np.ndarray, " T"]
    coordinates: Float[np.ndarray, "T R 3"]
    velocities: Float[np.ndarray, "T R 3"]
    statistics: SolveStatistics
    flowed: Float[np.ndarray, "T Q *K 3 3"] | None = None

    def carried(
        self, points: Float[np.ndarray, "P 3"], coordinates: Float[np.ndarray, "*T R 3"]
    ) -> Float[np.ndarray, "*T P 3"]:
        """Coordinates, or their derivatives, evaluated at material points given by their rest positions [m]."""
        return self.space.shape_values(points) @ coordinates

    def positions(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "T P 3"]:
        """Positions [m] at the frames of material points given by their rest positions [m]."""
        return self.carried(points, self.coordinates)

    def point_velocities(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "T P 3"]:
        """Their velocities [m/s]."""
        return self.carried(points, self.velocities)

    def handles(self) -> Float[np.ndarray, "T K 3 4"]:
        """Z_m(t) of φ(X) = X + Σ_m W_m(X) Z_m [X; 1], the constant weight first; zero at rest."""
        return self.space.handles(self.coordinates)


@dataclass(frozen=True)
class BodiesTrajectory:
    """States of several bodies at the frames.

    Attributes:
        times: [s], shape [T].
        bodies: the trajectory of each; their statistics are those of the whole.
        statistics: cost of the roll-out.
    """

    times: Float[np.ndarray, " T"]
    bodies: tuple[ReducedTrajectory, ...]
    statistics: SolveStatistics
