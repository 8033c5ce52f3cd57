"""What happens to a reduced body: obstacles, forces, damping, initial motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import Contact, FrameStates, Obstacle, Prepared, Timing, Wind
from physconvex.errors import InputError
from physconvex.fem import CONTACT_STIFFNESS_RATIO
from physconvex.numerics import rotation_matrix
from physconvex.reduced.body import ReducedBody
from physconvex.reduced.pins import PIN_STIFFNESS_RATIO, Pins, PinSprings
from physconvex.reduced.trajectory import ReducedTrajectory

__all__ = ["ReducedScene"]

Vector = Sequence[float] | Float[np.ndarray, " 3"]
Acceleration = Vector | Callable[[float], Vector]
SurfaceLoads = Float[np.ndarray, "S 3"] | Callable[[float], Float[np.ndarray, "S 3"]]


@dataclass(frozen=True)
class ReducedScene:
    """A reduced body and everything that acts on it, in SI units; the laws and defaults of `physconvex.fem.Scene`.

    Attributes:
        body: the reduced body.
        obstacles: planes and spheres with friction; they act on the surface samples.
        gravity: acceleration [m/s²].
        damping_time: Kelvin–Voigt time β [s]: viscosities are β μ and β λ.
        air_drag: mass-proportional damping α [1/s] (force −α m v).
        push: further uniform acceleration [m/s²], constant or a function of time [s]: a force on every part of the body
            in proportion to its mass.
        wind: moving or still air around the body.
        pins: points that are held or led along a path.
        loads: forces on the surface samples [N], shape [S, 3], constant or a function of time.
        initial_coordinates: state at t = 0 [m], shape [R, 3]; the rest state unless given, see `ReducedSpace.affine`.
        initial_orientation: rotation vector [rad] that turns that state about its centre of mass.
        initial_velocity: of the centre of mass [m/s].
        initial_angular_velocity: about the centre of mass [rad/s].
        contact_stiffness: kc [Pa/m]; 50 × (largest E) / (size of the body) unless given.
        contact_smoothing: depth over which contact sets in [m]; 5e-4 of the body's size unless given.
        slip_velocity: speed below which friction ramps to zero [m/s]; 2e-3 √(9.81 × size) unless given.
        contact_damping: τ [s] of a dashpot beside the contact's spring: pressure kc (depth + τ v), never below zero.

    Raises:
        InputError: a value out of its range or of the wrong shape.
    """

    body: ReducedBody
    obstacles: tuple[Obstacle, ...] = ()
    gravity: Vector = (0.0, 0.0, -9.81)
    damping_time: float = 0.0
    air_drag: float = 0.0
    push: Acceleration | None = None
    wind: Wind | None = None
    pins: Pins | None = None
    loads: SurfaceLoads | None = None
    initial_coordinates: Float[np.ndarray, "R 3"] | None = None
    initial_velocity: Vector = (0.0, 0.0, 0.0)
    initial_angular_velocity: Vector = (0.0, 0.0, 0.0)
    contact_stiffness: float | None = None
    contact_smoothing: float | None = None
    slip_velocity: float | None = None
    contact_damping: float = 0.0
    initial_orientation: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("gravity", "initial_orientation", "initial_velocity", "initial_angular_velocity"):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise InputError(f"{name}: got {getattr(self, name)!r}; expected three finite numbers")
        for name in ("damping_time", "air_drag", "contact_damping"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise InputError(f"{name}: got {getattr(self, name)}; expected a finite number ≥ 0")
        self.uniform_acceleration(0.0)
        shapes = {
            "loads": self.body.space.samples.surface_points.shape,
            "initial_coordinates": (self.body.space.dimension, 3),
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and not callable(value) and np.shape(value) != shape:
                raise InputError(f"{name}: got shape {np.shape(value)}; expected {shape}")

    def prepared(self, timing: Timing) -> Prepared:
        """Made ready for `physconvex.dynamics.simulate`."""
        from physconvex.reduced.simulation import prepared  # late: the equations of a scene know the scene

        return prepared(self, timing)

    def trajectory(self, frames: FrameStates) -> ReducedTrajectory:
        """The roll-out."""
        return ReducedTrajectory(
            self.body.space, frames.times, frames.positions, frames.velocities, frames.statistics, frames.flowed()
        )

    @property
    def autonomous(self) -> bool:
        """Whether nothing but constant forces does work on the body, and it stores no flow: energy cannot grow."""
        moving = [obstacle.velocity for obstacle in self.obstacles]
        moving += [] if self.wind is None else [self.wind.velocity]
        still = not any(callable(velocity) or np.any(velocity) for velocity in moving)
        led = self.pins is not None and self.pins.motion is not None
        return still and not led and not callable(self.push) and not callable(self.loads) and self.body.flow is None

    @property
    def energy_scale(self) -> float:
        """Kinetic energy at t = 0 and weight (at 9.81 m/s²) times size [J]."""
        v = self.start_velocities()
        weight = 9.81 * self.body.total_mass
        return 0.5 * float((v * (self.body.mass @ v)).sum()) + weight * self.body.space.samples.size

    @property
    def unturned(self) -> Float[np.ndarray, "R 3"]:
        """Coordinates at t = 0 before the initial orientation turns them [m]."""
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
        size = samples.size
        stiffness = CONTACT_STIFFNESS_RATIO * float(self.body.youngs_modulus.max()) / size
        return Contact(
            obstacles=tuple(self.obstacles),
            areas=samples.surface_areas,
            stiffness=stiffness if self.contact_stiffness is None else self.contact_stiffness,
            smoothing=5e-4 * size if self.contact_smoothing is None else self.contact_smoothing,
            slip_velocity=2e-3 * np.sqrt(9.81 * size) if self.slip_velocity is None else self.slip_velocity,
            damping=self.contact_damping,
        )

    def pin_springs(self) -> PinSprings | None:
        """The springs of the pins with their defaults resolved."""
        if self.pins is None:
            return None
        values = self.body.space.shape_values(self.pins.points)
        default = PIN_STIFFNESS_RATIO * float(self.body.youngs_modulus.max()) / self.body.space.samples.size
        stiffness = default if self.pins.stiffness is None else self.pins.stiffness
        return PinSprings(values, stiffness * np.asarray(self.pins.areas), values @ self.start, self.pins.motion)

    def uniform_acceleration(self, time: float) -> Float[np.ndarray, " 3"]:
        """Gravity and push [m/s²]."""
        gravity = np.asarray(self.gravity, dtype=np.float64)
        if self.push is None:
            return gravity
        push = np.asarray(self.push(time) if callable(self.push) else self.push, dtype=np.float64)
        if push.shape != (3,) or not np.isfinite(push).all():
            raise InputError(f"push: got {push!r} at t = {time:g} s; expected three finite numbers in m/s²")
        return gravity + push

    def external_forces(self, time: float) -> Float[np.ndarray, "R 3"]:
        """Gravity, push and loads as generalised forces [N]."""
        forces = self.body.first_moments[:, None] * self.uniform_acceleration(time)
        if self.loads is None:
            return forces
        loads = np.asarray(self.loads(time) if callable(self.loads) else self.loads)
        if loads.shape != self.body.space.samples.surface_points.shape:
            raise InputError(
                f"loads: the function gave shape {loads.shape} at t = {time:g} s; expected "
                f"{self.body.space.samples.surface_points.shape}, one force per surface sample"
            )
        return forces + self.body.space.surface_values.T @ loads
