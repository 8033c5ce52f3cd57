"""Springs that hold material points of a reduced body, or move them along a path.

An exactly clamped face removes every shape function that does not vanish on it, so that a reduced body of few functions
cannot deform near it. Springs with a stiffness per area instead add the compliance E/(k L) to the displacements, a
thousandth with the default stiffness.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError

PIN_STIFFNESS_RATIO = 1000.0  # k L / E: a clamp yields by about a thousandth of the body's displacements


@dataclass(frozen=True)
class PinSprings:
    """The springs of pins on a reduced body.

    Attributes:
        values: shape functions at the points, shape [C, R].
        weights: k A [N/m], shape [C].
        anchors: initial positions of the points [m], shape [C, 3].
        motion: as in `physconvex.dynamics.Pins`.
    """

    values: Float[np.ndarray, "C R"]
    weights: Float[np.ndarray, " C"]
    anchors: Float[np.ndarray, "C 3"]
    motion: Callable[[float], Float[np.ndarray, "C 3"]] | None

    @cached_property
    def matrix(self) -> Float[np.ndarray, "R R"]:
        """Second derivative of the energy, the same for each coordinate [N/m]."""
        return self.values.T @ (self.weights[:, None] * self.values)

    def targets(self, time: float) -> Float[np.ndarray, "C 3"]:
        """x*(t) [m].

        Raises:
            InputError: `motion` returns another shape than [C, 3], or values that are not finite.
        """
        if self.motion is None:
            return self.anchors
        targets = np.asarray(self.motion(time), dtype=np.float64)
        if targets.shape != self.anchors.shape or not np.isfinite(targets).all():
            raise InputError(
                f"pins.motion: got shape {targets.shape} at t = {time:g} s; expected finite positions [m] of shape "
                f"{self.anchors.shape}, one row per point"
            )
        return targets

    def pull(self, x: Float[np.ndarray, "R 3"], time: float) -> Float[np.ndarray, "C 3"]:
        """Force of each spring on the body [N] at coordinates x [m]."""
        return self.weights[:, None] * (self.targets(time) - self.values @ x)

    def energy_and_gradient(self, x: Float[np.ndarray, "R 3"], time: float) -> tuple[float, Float[np.ndarray, "R 3"]]:
        """Energy [J] and its derivative with respect to the coordinates [N]."""
        force = self.pull(x, time)
        return 0.5 * float((force**2 / self.weights[:, None]).sum()), -(self.values.T @ force)
