"""A body of finite elements in its world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from physconvex.dynamics import Contact, FrameStates, PreparedRollOut, SolveStatistics, Timing, World
from physconvex.errors import InputError
from physconvex.fem.body import ElasticBody
from physconvex.fem.carried_contact import CarriedContact, SurfacePoints
from physconvex.mesh import Embedding, TetMesh
from physconvex.numerics import rotation_matrix

_AT_NODE = 1e-6  # of the body's size: largest distance at which a point is identified with a node


@dataclass(frozen=True)
class NodePins:
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
                f"node_pins.nodes: got {nodes.dtype} of shape {nodes.shape}; expected at least one integer index, [C]. "
                "Turn a mask into indices with numpy.flatnonzero; leave pins out for a free body"
            )
        values, counts = np.unique(nodes, return_counts=True)
        if values[0] < 0:
            raise InputError(f"node_pins.nodes: got {values[0]}; expected indices ≥ 0, counted from the first node")
        if counts.max() > 1:
            raise InputError(
                f"node_pins.nodes: got node {values[counts.argmax()]} {counts.max()} times; expected each node once. "
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
                f"node_pins.motion: got {what} at t = {time:g} s; expected finite positions [m] of shape "
                f"{(len(self.nodes), 3)}, one row per pinned node. Check the function at that time"
            )
        return targets


@dataclass(frozen=True)
class Trajectory:
    """States at the frames: times [T] s, positions [T, V, 3] m and velocities [T, V, 3] m/s of the nodes, and cost."""

    times: Float[np.ndarray, " T"]
    positions: Float[np.ndarray, "T V 3"]
    velocities: Float[np.ndarray, "T V 3"]
    statistics: SolveStatistics


@dataclass(frozen=True)
class Scene(World):
    """A body of finite elements and everything that acts on it: a `World` plus inputs specific to nodes.

    Attributes:
        body: the elastic body.
        node_pins: nodes with prescribed motion, instead of `pins`, which must lie at nodes.
        initial_positions: state at t = 0 [m], shape [V, 3]; the rest state unless given.
        initial_velocities: of the nodes at t = 0 [m/s], shape [V, 3], in place of the rigid motion.
        contact_points: points of the surface at which obstacles act, instead of the boundary's nodes.

    Raises:
        InputError: a value out of its range or of the wrong shape, or one that finite elements do not support.
    """

    body: ElasticBody = field(kw_only=False)
    node_pins: NodePins | None = field(default=None, kw_only=True)
    initial_positions: Float[np.ndarray, "V 3"] | None = field(default=None, kw_only=True)
    initial_velocities: Float[np.ndarray, "V 3"] | None = field(default=None, kw_only=True)
    contact_points: SurfacePoints | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = self.body.mesh.vertices.shape
        for name in ("initial_positions", "initial_velocities"):
            given = getattr(self, name)
            if given is not None and np.shape(given) != shape:
                raise InputError(f"{name}: got shape {np.shape(given)}; expected {shape}")
        if self.hanging is not None and self.contact_points is not None:
            raise InputError("hanging: got a load and contact_points; expected contact at the nodes where a load hangs")
        if self.pins is not None and self.node_pins is not None:
            raise InputError("pins: got pins and node_pins; expected one of them")
        if self.held is not None:
            self._check_pins(self.held)

    def _check_pins(self, pins: NodePins) -> None:
        count, largest = len(self.body.mesh.vertices), int(np.max(pins.nodes))
        if largest >= count:
            raise InputError(
                f"node_pins.nodes: got node {largest}; expected indices below {count}, the number of nodes of the "
                "mesh. Take them from the mesh of this body"
            )
        pins.positions(0.0, self.start)

    def prepared(self, timing: Timing) -> PreparedRollOut:
        """Prepared for `physconvex.dynamics.simulate`."""
        from physconvex.fem.simulation import prepared_scene  # late: the equations of a scene know the scene

        return prepared_scene(self, timing)

    def trajectory(self, frames: FrameStates) -> Trajectory:
        """The roll-out."""
        return Trajectory(frames.times, frames.positions, frames.velocities, frames.statistics)

    @cached_property
    def held(self) -> NodePins | None:
        """The nodes with prescribed motion.

        Raises:
            InputError: pins that lie at no node.
        """
        if self.pins is None:
            return self.node_pins
        return NodePins(self._nodes_at("pins.points", self.pins.points), self.pins.motion)

    def _nodes_at(self, name: str, points: Float[np.ndarray, "P 3"]) -> Int[np.ndarray, " P"]:
        distance, nodes = cKDTree(self.body.mesh.vertices).query(points)
        if distance.max(initial=0.0) > _AT_NODE * self.body.mesh.size:
            raise InputError(
                f"{name}: one lies {distance.max():.3g} m from the nearest node; finite elements expect points at "
                "nodes. Take them from the vertices of this body's mesh"
            )
        return np.asarray(nodes)

    @cached_property
    def start(self) -> Float[np.ndarray, "V 3"]:
        """Positions at t = 0 [m]."""
        x = self.body.mesh.vertices if self.initial_positions is None else np.asarray(self.initial_positions)
        vector = np.asarray(self.initial_orientation, dtype=np.float64)
        if not vector.any():
            return x
        center = self.body.node_masses @ x / self.body.node_masses.sum()
        return center + (x - center) @ rotation_matrix(vector).T

    def start_velocities(self) -> Float[np.ndarray, "V 3"]:
        """Velocities at t = 0 [m/s]: as given, or rigid motion about the centre of mass; zero at pinned nodes."""
        if self.initial_velocities is not None:
            velocities = np.array(self.initial_velocities, dtype=np.float64)
        else:
            masses = self.body.node_masses
            center = masses @ self.start / masses.sum()
            spin = np.cross(np.asarray(self.initial_angular_velocity, dtype=np.float64), self.start - center)
            velocities = np.asarray(self.initial_velocity, dtype=np.float64) + spin
        if self.held is not None:
            velocities[self.held.nodes] = 0.0
        return velocities

    def contact(self) -> Contact:
        """The contact law with its defaults resolved."""
        mesh, points = self.body.mesh, self.contact_points
        if points is None:
            return self._contact(mesh.node_areas)
        law = self._contact(points.areas)
        given = {item.name: getattr(law, item.name) for item in fields(law) if item.init}
        return CarriedContact(**given, carried=_carried(mesh, points))

    def _contact(self, areas: Float[np.ndarray, " S"]) -> Contact:
        return self.contact_law(areas, youngs_modulus=float(self.body.youngs_modulus.max()), size=self.body.mesh.size)

    @cached_property
    def _loaded(self) -> csr_matrix | None:
        """Matrix from the loads' points to the nodes, shape [V, P]; None if they are the nodes."""
        assert self.loads is not None
        mesh = self.body.mesh
        if np.array_equal(self.loads.points, mesh.vertices):
            return None
        return Embedding.of_points(mesh, self.loads.points).matrix.T

    def external_forces(self, time: float) -> Float[np.ndarray, "V 3"]:
        """Gravity, push and loads on the nodes [N]."""
        forces = self.body.node_masses[:, None] * self.uniform_acceleration(time)
        if self.loads is None:
            return forces
        loads = self.loads.at(time)
        return forces + (loads if self._loaded is None else self._loaded @ loads)

    @cached_property
    def hanging_masses(self) -> Float[np.ndarray, " V"]:
        """Masses that hang on the nodes [kg].

        Raises:
            InputError: a load that hangs on no node.
        """
        masses = np.zeros(len(self.body.mesh.vertices))
        if self.hanging is not None:
            carrying = np.asarray(self.hanging.masses) > 0
            nodes = self._nodes_at("hanging.points", self.hanging.points[carrying])
            np.add.at(masses, nodes, np.asarray(self.hanging.masses)[carrying])
        return masses

    def free_nodes(self) -> np.ndarray:
        """Which nodes move freely, shape [V]."""
        free = np.ones(len(self.body.mesh.vertices), dtype=bool)
        if self.held is not None:
            free[self.held.nodes] = False
        return free


@lru_cache(maxsize=4)
def _carried(mesh: TetMesh, points: SurfacePoints) -> Embedding:
    """Embedding of the points in the mesh, cached: one roll-out uses it twice, and one with other parameters again."""
    return Embedding.of_points(mesh, points.points)
