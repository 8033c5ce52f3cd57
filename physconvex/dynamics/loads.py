"""What acts on a body besides obstacles: forces and masses at material points, held or led points, wind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from physconvex.dynamics.motion_path import MotionPath, Velocity
from physconvex.errors import InputError


def _points(name: str, points: np.ndarray) -> np.ndarray:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise InputError(f"{name}: got shape {array.shape}; expected finite [P, 3] in metres")
    return array


@dataclass(frozen=True, eq=False)
class Loads:
    """Forces at material points.

    Attributes:
        points: rest positions of the points [m], shape [P, 3].
        forces: on them [N], shape [P, 3], constant or a function of time [s].

    Raises:
        InputError: a wrong shape.
    """

    points: Float[np.ndarray, "P 3"]
    forces: Float[np.ndarray, "P 3"] | Callable[[float], Float[np.ndarray, "P 3"]]

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", _points("loads.points", self.points))
        if not callable(self.forces):
            self.at(0.0)

    def at(self, time: float) -> Float[np.ndarray, "P 3"]:
        """Forces at a time [N].

        Raises:
            InputError: the function returns another shape.
        """
        forces = np.asarray(self.forces(time) if callable(self.forces) else self.forces, dtype=np.float64)
        if forces.shape != self.points.shape:
            where = f" at t = {time:g} s" if callable(self.forces) else ""
            raise InputError(
                f"loads: got shape {forces.shape}{where}; expected {self.points.shape}, one force per point"
            )
        return forces


@dataclass(frozen=True, eq=False)
class HangingLoad:
    """Masses that hang on a body by a string.

    Attributes:
        points: rest positions of the points that it hangs on [m], shape [P, 3].
        masses: that hang there [kg], shape [P].
        slack: of the string [m]; zero fixes the masses to the body.

    Raises:
        InputError: a wrong shape, a negative mass or slack, or no mass at all.
    """

    points: Float[np.ndarray, "P 3"]
    masses: Float[np.ndarray, " P"]
    slack: float = 0.0

    def __post_init__(self) -> None:
        points, masses = _points("hanging.points", self.points), np.asarray(self.masses, dtype=np.float64)
        object.__setattr__(self, "points", points)
        if masses.shape != points.shape[:1]:
            raise InputError(f"hanging.masses: got shape {masses.shape}; expected {points.shape[:1]}, one per point")
        if not (np.isfinite(masses).all() and (masses >= 0).all() and masses.sum() > 0):
            raise InputError("hanging.masses: expected finite masses ≥ 0 [kg], at least one of them positive")
        if not (np.isfinite(self.slack) and self.slack >= 0):
            raise InputError(f"hanging.slack: got {self.slack}; expected a finite length ≥ 0 [m]")


@dataclass(frozen=True)
class Pins:
    """Points that are held or moved.

    Finite elements hold the nodes at these points exactly. A reduced body is held by springs of the energy ½ Σ k A
    |φ(X) − x*(t)|²: an exactly clamped face removes every shape function that does not vanish on it.

    Attributes:
        points: rest positions of the points [m], shape [C, 3].
        areas: boundary area of each [m²], shape [C], or one for all.
        motion: x*(t) [m] as a function of time [s], shape [C, 3]; None holds the points at their start.
        stiffness: k [Pa/m] of the springs; 1000 × (largest E) / (size of the body) unless given.

    Raises:
        InputError: a wrong shape or range.
    """

    points: Float[np.ndarray, "C 3"]
    areas: float | Float[np.ndarray, " C"]
    motion: Callable[[float], Float[np.ndarray, "C 3"]] | None = None
    stiffness: float | None = None

    def __post_init__(self) -> None:
        points = np.asarray(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
            raise InputError(f"pins.points: got shape {points.shape}; expected finite [C, 3] in metres, C > 0")
        areas = np.asarray(self.areas, dtype=np.float64)
        if areas.shape not in ((), (len(points),)) or not (np.isfinite(areas) & (areas > 0)).all():
            raise InputError(f"pins.areas: got shape {areas.shape}; expected a number or [{len(points)}], > 0 in m²")
        if self.stiffness is not None and not (np.isfinite(self.stiffness) and self.stiffness > 0):
            raise InputError(f"pins.stiffness: got {self.stiffness}; expected a finite number > 0 in Pa/m")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "areas", np.broadcast_to(areas, len(points)).copy())


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
