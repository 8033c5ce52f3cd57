"""Wind and quadratic air drag on the surface of a body."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from physconvex.dynamics.motion_path import MotionPath, Velocity
from physconvex.errors import InputError


@dataclass(frozen=True)
class Wind:
    """Moving or still air: each surface sample feels −c A |r| r, r = v − w, with c = ρ_air C_d / 8.

    A convex body of random orientation exposes a quarter of its surface to the wind (Cauchy's formula), so that a body
    in translation feels ½ ρ_air C_d A_shown |r|², with C_d as tabulated for its shape. The force is minus the
    derivative of the convex rate potential Σ c A |r|³ / 3. It depends on the velocity relative to the air at each
    sample, not on the direction of the surface there.

    Attributes:
        velocity: of the air [m/s], or a function of time [s] that gives it.
        drag_coefficient: C_d [-].
        air_density: ρ_air [kg/m³].

    Raises:
        InputError: a value out of range.
    """

    velocity: Velocity = (0.0, 0.0, 0.0)
    drag_coefficient: float = 1.0
    air_density: float = 1.2
    _path: MotionPath = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_path", MotionPath(self.velocity))
        for name in ("drag_coefficient", "air_density"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise InputError(f"{name}: got {getattr(self, name)}; expected a finite number ≥ 0")

    def velocity_at(self, time: float) -> Float[np.ndarray, " 3"]:
        """Velocity of the air [m/s]."""
        return self._path.velocity(time)

    def _relative(self, velocity: np.ndarray, areas: np.ndarray, time: float) -> tuple[np.ndarray, ...]:
        """r, |r|, and c A."""
        relative = velocity - self.velocity_at(time)
        return relative, np.linalg.norm(relative, axis=1), self.air_density * self.drag_coefficient / 8 * areas

    def energy_and_gradient(
        self, velocity: Float[np.ndarray, "S 3"], areas: Float[np.ndarray, " S"], time: float
    ) -> tuple[float, Float[np.ndarray, "S 3"]]:
        """Rate potential [W] and its derivative with respect to the velocities of the samples [N]."""
        relative, speed, weights = self._relative(velocity, areas, time)
        return float(weights @ speed**3) / 3, (weights * speed)[:, None] * relative

    def blocks(
        self, velocity: Float[np.ndarray, "S 3"], areas: Float[np.ndarray, " S"], time: float
    ) -> Float[np.ndarray, "S 3 3"]:
        """Second derivative of the rate potential, c A (|r| I + r rᵀ/|r|) [N·s/m]."""
        relative, speed, weights = self._relative(velocity, areas, time)
        along = relative[:, :, None] * relative[:, None, :] / np.maximum(speed, 1e-300)[:, None, None]
        return weights[:, None, None] * (speed[:, None, None] * np.eye(3) + along)
