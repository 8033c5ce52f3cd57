"""What happens to a body: obstacles, forces, damping, pins, initial motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from physconvex.dynamics import Contact, FrameStates, Obstacle, Prepared, Timing, Wind
from physconvex.errors import InputError
from physconvex.fem.body import ElasticBody
from physconvex.fem.carried_contact import CarriedContact, SurfacePoints
from physconvex.fem.hanging_load import HangingLoad
from physconvex.fem.trajectory import Trajectory
from physconvex.mesh import Embedding, TetMesh

__all__ = ["Loads", "Pins", "Scene", "contact_defaults"]

Vector = Sequence[float] | Float[np.ndarray, " 3"]
Loads = Float[np.ndarray, "V 3"] | Callable[[float], Float[np.ndarray, "V 3"]]
CONTACT_STIFFNESS_RATIO = 50.0  # kc·L / E: measured bias of E below 0.01 decades


def contact_defaults(youngs_modulus: float, size: float) -> tuple[float, float, float]:
    """Stiffness kc [Pa/m], smoothing ε [m] and slip velocity v_s [m/s] of a body of that E [Pa] and size [m]."""
    return CONTACT_STIFFNESS_RATIO * youngs_modulus / size, 5e-4 * size, 2e-3 * np.sqrt(9.81 * size)


@dataclass(frozen=True)
class Pins:
    """Nodes whose positions are prescribed.

    Attributes:
        nodes: indices of the nodes, each once, shape [C].
        motion: positions [m] as a function of time [s], shape [C, 3]; None holds them where they start.

    Raises:
        InputError: `nodes` is not a list of different node indices.
    """

    nodes: Int[np.ndarray, " C"]
    motion: Callable[[float], Float[np.ndarray, "C 3"]] | None = None

    def __post_init__(self) -> None:
        nodes = np.asarray(self.nodes)
        if nodes.ndim != 1 or not np.issubdtype(nodes.dtype, np.integer) or not len(nodes):
            raise InputError(
                f"pins.nodes: got {nodes.dtype} of shape {nodes.shape}; expected at least one integer index, [C]. "
                "Turn a mask into indices with numpy.flatnonzero; leave pins out for a free body"
            )
        values, counts = np.unique(nodes, return_counts=True)
        if values[0] < 0:
            raise InputError(f"pins.nodes: got {values[0]}; expected indices ≥ 0, counted from the first node")
        if counts.max() > 1:
            raise InputError(
                f"pins.nodes: got node {values[counts.argmax()]} {counts.max()} times; expected each node once. "
                "Remove what numpy.unique would"
            )

    def positions(self, time: float, start: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "C 3"]:
        """Prescribed positions [m] at a time [s], for nodes that started at `start` [m].

        Raises:
            InputError: `motion` gave another shape than [C, 3], or values that are not finite.
        """
        if self.motion is None:
            return start[self.nodes]
        targets = np.asarray(self.motion(time), dtype=np.float64)
        if targets.shape != (len(self.nodes), 3) or not np.isfinite(targets).all():
            what = f"shape {targets.shape}" if np.isfinite(targets).all() else "values that are not finite"
            raise InputError(
                f"pins.motion: got {what} at t = {time:g} s; expected finite positions [m] of shape "
                f"{(len(self.nodes), 3)}, one row per pinned node. Check the function at that time"
            )
        return targets


@dataclass(frozen=True)
class Scene:
    """A body and everything that acts on it, in SI units.

    Attributes:
        body: the elastic body.
        obstacles: planes and spheres with friction.
        gravity: acceleration [m/s²].
        damping_time: Kelvin–Voigt time β [s]: viscosities are β μ and β λ (stiffness-proportional Rayleigh).
        air_drag: mass-proportional damping α [1/s] (force −α m v).
        wind: moving or still air around the body.
        pins: nodes with prescribed motion.
        loads: forces on the nodes [N], shape [V, 3], constant or a function of time.
        hanging: a load that hangs on nodes, loosely at first.
        initial_positions: state at t = 0 [m], shape [V, 3]; the rest state unless given.
        initial_velocity: of the centre of mass [m/s].
        initial_angular_velocity: about the centre of mass [rad/s].
        contact_stiffness: kc [Pa/m]; 50 × (largest E) / (size of the body) unless given.
        contact_smoothing: depth over which contact sets in [m]; 5e-4 of the body's size unless given.
        slip_velocity: speed below which friction ramps to zero [m/s]; 2e-3 √(9.81 × size) unless given.
        contact_damping: τ [s] of a dashpot beside the contact's spring: pressure kc (depth + τ v), never below zero.
        contact_points: points of the surface at which obstacles act, in the place of the boundary's nodes.
    """

    body: ElasticBody
    obstacles: tuple[Obstacle, ...] = ()
    gravity: Vector = (0.0, 0.0, -9.81)
    damping_time: float = 0.0
    air_drag: float = 0.0
    wind: Wind | None = None
    pins: Pins | None = None
    loads: Loads | None = None
    initial_positions: Float[np.ndarray, "V 3"] | None = None
    initial_velocity: Vector = (0.0, 0.0, 0.0)
    initial_angular_velocity: Vector = (0.0, 0.0, 0.0)
    contact_stiffness: float | None = None
    contact_smoothing: float | None = None
    slip_velocity: float | None = None
    contact_damping: float = 0.0
    contact_points: SurfacePoints | None = None
    hanging: HangingLoad | None = None

    def __post_init__(self) -> None:
        for name in ("gravity", "initial_velocity", "initial_angular_velocity"):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise InputError(f"{name}: got {getattr(self, name)!r}; expected three finite numbers")
        for name in ("damping_time", "air_drag", "contact_damping"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise InputError(f"{name}: got {getattr(self, name)}; expected a finite number ≥ 0")
        shape = self.body.mesh.vertices.shape
        for name in ("initial_positions", "loads"):
            value = getattr(self, name)
            if value is not None and not callable(value) and np.shape(value) != shape:
                raise InputError(f"{name}: got shape {np.shape(value)}; expected {shape}")
        if self.hanging is not None and np.shape(self.hanging.masses) != shape[:1]:
            raise InputError(f"hanging.masses: got shape {np.shape(self.hanging.masses)}; expected {shape[:1]}")
        if self.hanging is not None and self.contact_points is not None:
            raise InputError("hanging: got a load and contact_points; expected contact at the nodes where a load hangs")
        if self.pins is not None:
            self._check_pins(self.pins)

    def _check_pins(self, pins: Pins) -> None:
        count, largest = len(self.body.mesh.vertices), int(np.max(pins.nodes))
        if largest >= count:
            raise InputError(
                f"pins.nodes: got node {largest}; expected indices below {count}, the number of nodes of the mesh. "
                "Take them from the mesh of this body"
            )
        pins.positions(0.0, self.start)

    def prepared(self, timing: Timing) -> Prepared:
        """Made ready for `physconvex.dynamics.simulate`."""
        from physconvex.fem.simulation import prepared  # late: the equations of a scene know the scene

        return prepared(self, timing)

    def trajectory(self, frames: FrameStates) -> Trajectory:
        """The roll-out."""
        return Trajectory(frames.times, frames.positions, frames.velocities, frames.statistics)

    @property
    def start(self) -> Float[np.ndarray, "V 3"]:
        """Positions at t = 0 [m]."""
        return self.body.mesh.vertices if self.initial_positions is None else np.asarray(self.initial_positions)

    def start_velocities(self) -> Float[np.ndarray, "V 3"]:
        """Velocities at t = 0 [m/s]: rigid motion about the centre of mass, zero at pinned nodes."""
        masses = self.body.node_masses
        center = masses @ self.start / masses.sum()
        spin = np.cross(np.asarray(self.initial_angular_velocity, dtype=np.float64), self.start - center)
        velocities = np.asarray(self.initial_velocity, dtype=np.float64) + spin
        if self.pins is not None:
            velocities[self.pins.nodes] = 0.0
        return velocities

    def contact(self) -> Contact | CarriedContact:
        """The contact law with its defaults resolved."""
        mesh, points = self.body.mesh, self.contact_points
        if points is None:
            return self._contact(mesh.node_areas)
        return CarriedContact(self._contact(points.areas), _carried(mesh, points))

    def _contact(self, areas: Float[np.ndarray, " S"]) -> Contact:
        stiffness, smoothing, slip = contact_defaults(float(self.body.youngs_modulus.max()), self.body.mesh.size)
        return Contact(
            obstacles=tuple(self.obstacles),
            areas=areas,
            stiffness=stiffness if self.contact_stiffness is None else self.contact_stiffness,
            smoothing=smoothing if self.contact_smoothing is None else self.contact_smoothing,
            slip_velocity=slip if self.slip_velocity is None else self.slip_velocity,
            damping=self.contact_damping,
        )

    def external_forces(self, time: float) -> Float[np.ndarray, "V 3"]:
        """Gravity and loads on the nodes [N]."""
        forces = self.body.node_masses[:, None] * np.asarray(self.gravity, dtype=np.float64)
        if self.loads is not None:
            forces = forces + (self.loads(time) if callable(self.loads) else self.loads)
        return forces

    def free_nodes(self) -> np.ndarray:
        """Which nodes move freely, shape [V]."""
        free = np.ones(len(self.body.mesh.vertices), dtype=bool)
        if self.pins is not None:
            free[self.pins.nodes] = False
        return free


@lru_cache(maxsize=4)
def _carried(mesh: TetMesh, points: SurfacePoints) -> Embedding:
    """Where the mesh carries the points: one roll-out asks twice, and one with other parameters again."""
    return Embedding.of_points(mesh, points.points)
