"""Environment and loads of a body, independent of its discretisation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from physconvex.dynamics.contact import Contact, Obstacle, contact_defaults
from physconvex.dynamics.loads import HangingLoad, Loads, Pins, Wind
from physconvex.errors import InputError

Vector = Sequence[float] | Float[np.ndarray, " 3"]
Acceleration = Vector | Callable[[float], Vector]


@dataclass(frozen=True, kw_only=True)
class World:
    """Everything that acts on a body, and its initial motion, in SI units.

    `physconvex.fem.Scene` and `physconvex.reduced.ReducedScene` are worlds with a body. Each rejects inputs that it
    does not support, with an error that names them.

    Attributes:
        obstacles: planes and spheres with friction.
        gravity: acceleration [m/s²].
        push: further uniform acceleration [m/s²], constant or a function of time [s]: a force in proportion to mass.
        damping_time: Kelvin–Voigt time β [s]: viscosities are β μ and β λ (stiffness-proportional Rayleigh).
        air_drag: mass-proportional damping α [1/s] (force −α m v).
        wind: moving or still air around the body.
        loads: forces at material points.
        hanging: a load that hangs on the body, initially with slack.
        pins: material points that are held or moved along a path.
        initial_orientation: rotation vector [rad] of the state at t = 0 about its centre of mass.
        initial_velocity: of the centre of mass [m/s].
        initial_angular_velocity: about the centre of mass [rad/s].
        contact_stiffness: kc [Pa/m]; 50 × (largest E) / (size of the body) unless given.
        contact_smoothing: depth of the smooth onset of contact [m]; 5e-4 of the body's size unless given.
        slip_velocity: speed below which friction ramps to zero [m/s]; 2e-3 √(9.81 × size) unless given.
        contact_damping: τ [s] of a dashpot parallel to the contact's spring: pressure kc (depth + τ v), never below
            zero.

    Raises:
        InputError: a value out of its range.
    """

    obstacles: tuple[Obstacle, ...] = ()
    gravity: Vector = (0.0, 0.0, -9.81)
    push: Acceleration | None = None
    damping_time: float = 0.0
    air_drag: float = 0.0
    wind: Wind | None = None
    loads: Loads | None = None
    hanging: HangingLoad | None = None
    pins: Pins | None = None
    initial_orientation: Vector = (0.0, 0.0, 0.0)
    initial_velocity: Vector = (0.0, 0.0, 0.0)
    initial_angular_velocity: Vector = (0.0, 0.0, 0.0)
    contact_stiffness: float | None = None
    contact_smoothing: float | None = None
    slip_velocity: float | None = None
    contact_damping: float = 0.0

    def __post_init__(self) -> None:
        for name in ("gravity", "initial_orientation", "initial_velocity", "initial_angular_velocity"):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise InputError(f"{name}: got {getattr(self, name)!r}; expected three finite numbers")
        for name in ("damping_time", "air_drag", "contact_damping"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise InputError(f"{name}: got {getattr(self, name)}; expected a finite number ≥ 0")
        self.uniform_acceleration(0.0)

    def uniform_acceleration(self, time: float) -> Float[np.ndarray, " 3"]:
        """Gravity and push [m/s²]."""
        gravity = np.asarray(self.gravity, dtype=np.float64)
        if self.push is None:
            return gravity
        push = np.asarray(self.push(time) if callable(self.push) else self.push, dtype=np.float64)
        if push.shape != (3,) or not np.isfinite(push).all():
            raise InputError(f"push: got {push!r} at t = {time:g} s; expected three finite numbers in m/s²")
        return gravity + push

    def contact_law(self, areas: Float[np.ndarray, " S"], *, youngs_modulus: float, size: float) -> Contact:
        """The contact law with its defaults resolved.

        Args:
            areas: boundary area of each point at which obstacles act [m²].
            youngs_modulus: the largest of the body [Pa].
            size: of the body [m].
        """
        given = self.contact_stiffness, self.contact_smoothing, self.slip_velocity
        usual = contact_defaults(youngs_modulus, size)
        stiffness, smoothing, slip = (u if g is None else g for g, u in zip(given, usual, strict=True))
        return Contact(tuple(self.obstacles), areas, stiffness, smoothing, slip, self.contact_damping)


SceneT = TypeVar("SceneT", bound=World)


def in_world(scene: Callable[..., SceneT], body: object, world: World, **own: Any) -> SceneT:
    """A body in the world of another scene: `in_world(Scene, body, reduced_scene, contact_points=points)`.

    Args:
        scene: the class of the new scene.
        body: the body in it.
        world: the world.
        own: inputs that the new scene has in addition, or differently.
    """
    return scene(body, **({field.name: getattr(world, field.name) for field in fields(World)} | own))
