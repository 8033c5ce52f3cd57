"""A reduced body in its world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import Contact, FrameStates, PreparedRollOut, Timing, World
from physconvex.errors import InputError
from physconvex.numerics import rotation_matrix
from physconvex.reduced.body import ReducedBody
from physconvex.reduced.trajectory import ReducedTrajectory

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


@dataclass(frozen=True)
class ReducedScene(World):
    """A reduced body and everything that acts on it: a `World`; obstacles and wind act on the surface samples.

    Attributes:
        body: the reduced body.
        initial_coordinates: state at t = 0 [m], shape [R, 3]; the rest state unless given, see `ReducedSpace.affine`.

    Raises:
        InputError: a value out of its range or of the wrong shape, or a hanging load, which no reduced body carries.
    """

    body: ReducedBody = field(kw_only=False)
    initial_coordinates: Float[np.ndarray, "R 3"] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = (self.body.space.dimension, 3)
        if self.initial_coordinates is not None and np.shape(self.initial_coordinates) != shape:
            raise InputError(f"initial_coordinates: got shape {np.shape(self.initial_coordinates)}; expected {shape}")
        if self.hanging is not None:
            raise InputError(
                "hanging: got a load that hangs on a reduced body; it exists with finite elements only. Leave it out, "
                "or make the body's cells heavier where it hangs"
            )

    def prepared(self, timing: Timing) -> PreparedRollOut:
        """Prepared for `physconvex.dynamics.simulate`."""
        from physconvex.reduced.simulation import prepared_roll_out  # late: the equations of a scene know the scene

        return prepared_roll_out(self, timing)

    def trajectory(self, frames: FrameStates) -> ReducedTrajectory:
        """The roll-out."""
        return ReducedTrajectory(
            self.body.space, frames.times, frames.positions, frames.velocities, frames.statistics, frames.flowed()
        )

    @property
    def autonomous(self) -> bool:
        """Whether only constant forces do work on the body, and it stores no flow: energy cannot grow."""
        moving = [obstacle.velocity for obstacle in self.obstacles]
        moving += [] if self.wind is None else [self.wind.velocity]
        still = not any(callable(velocity) or np.any(velocity) for velocity in moving)
        led = self.pins is not None and self.pins.motion is not None
        return (
            still
            and not led
            and not callable(self.push)
            and (self.loads is None or not callable(self.loads.forces))
            and self.body.flow is None
        )

    @property
    def energy_scale(self) -> float:
        """Kinetic energy at t = 0 and weight (at 9.81 m/s²) times size [J]."""
        v = self.start_velocities()
        weight = 9.81 * self.body.total_mass
        return 0.5 * float((v * (self.body.mass @ v)).sum()) + weight * self.body.space.samples.size

    @property
    def unturned(self) -> Float[np.ndarray, "R 3"]:
        """Coordinates at t = 0 before the initial rotation [m]."""
        return self.body.rest if self.initial_coordinates is None else np.asarray(self.initial_coordinates)

    @property
    def start(self) -> Float[np.ndarray, "R 3"]:
        """Coordinates at t = 0 [m]."""
        vector, y = np.asarray(self.initial_orientation, dtype=np.float64), self.unturned
        if not vector.any():
            return y
        turn, center = rotation_matrix(vector), self.body.first_moments @ y / self.body.total_mass
        return y @ turn.T + self.body.space.affine(np.zeros((3, 3)), center - turn @ center)

    def start_velocities(self) -> Float[np.ndarray, "R 3"]:
        """Velocities of the coordinates at t = 0 [m/s]: rigid motion about the centre of mass."""
        spin = np.asarray(self.initial_angular_velocity, dtype=np.float64)
        center = self.body.first_moments @ self.start / self.body.total_mass
        drift = np.asarray(self.initial_velocity, dtype=np.float64) - np.cross(spin, center)
        # ω × φ(X) is linear in φ, hence in the coordinates
        return np.cross(spin, self.start) + self.body.space.affine(np.zeros((3, 3)), drift)

    def contact(self) -> Contact:
        """The contact law of the surface samples with its defaults resolved."""
        samples = self.body.space.samples
        return self.contact_law(
            samples.surface_areas, youngs_modulus=float(self.body.youngs_modulus.max()), size=samples.size
        )

    def pin_springs(self) -> PinSprings | None:
        """The springs of the pins with their defaults resolved."""
        if self.pins is None:
            return None
        values = self.body.space.shape_values(self.pins.points)
        default = PIN_STIFFNESS_RATIO * float(self.body.youngs_modulus.max()) / self.body.space.samples.size
        stiffness = default if self.pins.stiffness is None else self.pins.stiffness
        return PinSprings(values, stiffness * np.asarray(self.pins.areas), values @ self.start, self.pins.motion)

    @cached_property
    def load_values(self) -> Float[np.ndarray, "P R"]:
        """Shape functions at the points of the loads."""
        assert self.loads is not None
        space = self.body.space
        if np.array_equal(self.loads.points, space.samples.surface_points):
            return space.surface_values
        return space.shape_values(self.loads.points)

    def external_forces(self, time: float) -> Float[np.ndarray, "R 3"]:
        """Gravity, push and loads as generalised forces [N]."""
        forces = self.body.first_moments[:, None] * self.uniform_acceleration(time)
        return forces if self.loads is None else forces + self.load_values.T @ self.loads.at(time)
