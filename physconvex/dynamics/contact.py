"""Contact of nodes with planes and spheres: area-weighted C² hinge and smoothed, lagged Coulomb friction.

A node that carries the boundary area A and lies p = −gap deep in an obstacle has the energy A ψ(p), with

    ψ(p) = kc p³ / (6 ε)                    0 < p < ε
         = kc (p²/2 − p ε/2 + ε²/6)         p ≥ ε

so that pressure kc·p [Pa] is reached smoothly; kc [Pa/m] is a stiffness per area and independent of the mesh. Friction
follows the smoothed Coulomb law of Li et al. 2020 (IPC), eq. 14: force μ N f₁(|v_t|) with f₁ = 1 above the velocity
`v_s` and a smooth ramp below. During one solve it is frozen to a linear drag, see `Contact.freeze_friction`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from physconvex.dynamics.motion_path import MotionPath, Velocity
from physconvex.errors import InputError

Vector = Sequence[float] | Float[np.ndarray, " 3"]
_STIFFNESS = 50.0  # kc·L / E: measured bias of E below 0.01 decades
_SMOOTHING = 5e-4  # ε / L
_SLIP = 2e-3  # v_s / √(9.81 m/s² L)


def contact_defaults(youngs_modulus: float, size: float) -> tuple[float, float, float]:
    """Stiffness kc [Pa/m], smoothing ε [m] and slip velocity v_s [m/s] of a body of that E [Pa] and size L [m]."""
    return _STIFFNESS * youngs_modulus / size, _SMOOTHING * size, _SLIP * float(np.sqrt(9.81 * size))


def _vector(name: str, value: Vector) -> np.ndarray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{name}: got {value!r}; expected three finite numbers")
    return array


class _Moving:
    """What planes and spheres share: friction and motion; a constant velocity becomes an array in place."""

    friction: float
    velocity: Velocity
    _path: MotionPath

    def __post_init__(self) -> None:
        object.__setattr__(self, "_path", MotionPath(self.velocity))
        if not callable(self.velocity):
            object.__setattr__(self, "velocity", self._path.velocity(0.0))
        if not (np.isfinite(self.friction) and self.friction >= 0):
            raise InputError(f"friction: got {self.friction}; expected a finite coefficient ≥ 0")

    def velocity_at(self, time: float) -> Float[np.ndarray, " 3"]:
        """Velocity at a time [m/s]."""
        return self._path.velocity(time)


@dataclass(frozen=True)
class Plane(_Moving):
    """Half-space {x : (x − point(t))·normal < 0} that bodies must not enter.

    Attributes:
        point: a point on the plane at t = 0 [m].
        normal: outward direction, any length.
        friction: Coulomb coefficient [-].
        velocity: velocity of the plane [m/s], or a function of time [s] that gives it; a tangential part is a
            conveyor belt.
    """

    point: Vector = (0.0, 0.0, 0.0)
    normal: Vector = (0.0, 0.0, 1.0)
    friction: float = 0.0
    velocity: Velocity = (0.0, 0.0, 0.0)
    _path: MotionPath = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("point", "normal"):
            object.__setattr__(self, name, _vector(name, getattr(self, name)))
        length = np.linalg.norm(self.normal)
        if length == 0:
            raise InputError("normal: got the zero vector; expected a direction")
        object.__setattr__(self, "normal", np.asarray(self.normal) / length)

    def gap(self, x: Float[np.ndarray, "V 3"], time: float) -> Float[np.ndarray, " V"]:
        """Signed distance [m], negative inside."""
        return (x - (np.asarray(self.point) + self._path.displacement(time))) @ np.asarray(self.normal)

    def normals(self, x: Float[np.ndarray, "V 3"], time: float) -> Float[np.ndarray, "V 3"]:
        """Gradient of the gap."""
        return np.broadcast_to(np.asarray(self.normal), x.shape)

    def curvature(self, x: Float[np.ndarray, "V 3"], time: float) -> Float[np.ndarray, " V"]:
        """Curvature of the level set [1/m]: the gap's Hessian is curvature × (I − n nᵀ)."""
        return np.zeros(len(x))


@dataclass(frozen=True)
class Sphere(_Moving):
    """Solid sphere that bodies must not enter: `center` [m] at t = 0, `radius` [m], `velocity` [m/s] or a function."""

    center: Vector
    radius: float
    friction: float = 0.0
    velocity: Velocity = (0.0, 0.0, 0.0)
    _path: MotionPath = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "center", _vector("center", self.center))
        if not (np.isfinite(self.radius) and self.radius > 0):
            raise InputError(f"radius: got {self.radius}; expected a length > 0 in metres")

    def center_at(self, time: float) -> Float[np.ndarray, " 3"]:
        """Position of the centre at a time [m]."""
        return np.asarray(self.center) + self._path.displacement(time)

    def _offset(self, x: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        offset = x - self.center_at(time)
        return offset, np.maximum(np.linalg.norm(offset, axis=1), 1e-12)

    def gap(self, x: Float[np.ndarray, "V 3"], time: float) -> Float[np.ndarray, " V"]:
        """Signed distance [m], negative inside."""
        return self._offset(x, time)[1] - self.radius

    def normals(self, x: Float[np.ndarray, "V 3"], time: float) -> Float[np.ndarray, "V 3"]:
        """Gradient of the gap."""
        offset, distance = self._offset(x, time)
        return offset / distance[:, None]

    def curvature(self, x: Float[np.ndarray, "V 3"], time: float) -> Float[np.ndarray, " V"]:
        """Curvature of the level set [1/m]."""
        return 1.0 / self._offset(x, time)[1]


Obstacle = Plane | Sphere


def obstacle_rows(obstacles: Sequence[Obstacle], time: float) -> Float[np.ndarray, "O 9"]:
    """Obstacles at a time [s] in the format of the compiled kernels, `struct Obstacle` of sources/shared/obstacle.h."""
    return np.array([_row(obstacle, time) for obstacle in obstacles]).reshape(-1, 9)


def _row(obstacle: Obstacle, time: float) -> list[float]:
    if isinstance(obstacle, Plane):
        where, size = obstacle.normal, -float(obstacle.gap(np.zeros((1, 3)), time)[0])
    else:
        where, size = obstacle.center_at(time), obstacle.radius
    return [float(isinstance(obstacle, Sphere)), *where, size, *obstacle.velocity_at(time), obstacle.friction]


@dataclass(frozen=True)
class Friction:
    """Friction on the nodes that touch one obstacle, frozen to a linear drag for one solve.

    Attributes:
        nodes: node indices, shape [C].
        weights: force over slip velocity [N·s/m], shape [C].
        normals: shape [C, 3].
        velocity: velocity of the obstacle [m/s], shape [3].
        along_normal: a dashpot across the contact instead, which acts on the normal velocity.
    """

    nodes: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    velocity: np.ndarray
    along_normal: bool = False

    def slip(self, velocity: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "C 3"]:
        """Tangential (or normal) velocity relative to the obstacle [m/s]."""
        relative = velocity[self.nodes] - self.velocity
        normal = (relative * self.normals).sum(1, keepdims=True) * self.normals
        return normal if self.along_normal else relative - normal

    @property
    def projections(self) -> Float[np.ndarray, "C 3 3"]:
        """Matrix from a velocity to `slip`."""
        normal = self.normals[:, :, None] * self.normals[:, None, :]
        return normal if self.along_normal else np.eye(3) - normal


@dataclass(frozen=True)
class Contact:
    """Contact law of one body with a list of obstacles.

    Attributes:
        obstacles: planes and spheres.
        areas: boundary area of each node [m²], zero for inner nodes, shape [V].
        stiffness: kc [Pa/m].
        smoothing: ε [m].
        slip_velocity: v_s [m/s], below which friction ramps to zero.
        damping: τ [s] of a dashpot kc ψ'' A τ parallel to the spring, never pulling in total; it reduces the rebound.
    """

    obstacles: tuple[Obstacle, ...]
    areas: Float[np.ndarray, " V"]
    stiffness: float
    smoothing: float
    slip_velocity: float
    damping: float = 0.0
    nodes: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        for name in ("stiffness", "smoothing", "slip_velocity"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{name}: got {value}; expected a finite number > 0")
        object.__setattr__(self, "nodes", np.flatnonzero(self.areas > 0))

    def hinge(self, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """ψ [N/m], ψ' [N/m²] and ψ'' [N/m³] at depths p > 0 [m], per area of contact."""
        k, e = self.stiffness, self.smoothing
        soft = depth < e
        energy = np.where(soft, depth**3 / (6 * e), depth**2 / 2 - depth * e / 2 + e * e / 6)
        slope = np.where(soft, depth**2 / (2 * e), depth - e / 2)
        return k * energy, k * slope, k * np.where(soft, depth / e, 1.0)

    def touching(self, obstacle: Obstacle, x: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Nodes inside an obstacle, and their depths [m]."""
        depth = -obstacle.gap(x[self.nodes], time)
        inside = depth > 0
        return self.nodes[inside], depth[inside]

    def _touched(self, x: np.ndarray, time: float) -> Iterator[tuple[Obstacle, np.ndarray, np.ndarray]]:
        """The obstacles that nodes are inside of, those nodes, and their depths [m]."""
        for obstacle in self.obstacles:
            nodes, depth = self.touching(obstacle, x, time)
            if len(nodes):
                yield obstacle, nodes, depth

    def energy_and_gradient(self, x: Float[np.ndarray, "V 3"], time: float) -> tuple[float, Float[np.ndarray, "V 3"]]:
        """Contact energy [J] and its derivative [N]."""
        total, gradient = 0.0, np.zeros_like(x)
        for obstacle, nodes, depth in self._touched(x, time):
            energy, slope, _ = self.hinge(depth)
            total += float(self.areas[nodes] @ energy)
            gradient[nodes] -= (self.areas[nodes] * slope)[:, None] * obstacle.normals(x[nodes], time)
        return total, gradient

    def hessian_blocks(self, x: Float[np.ndarray, "V 3"], time: float) -> Float[np.ndarray, "V 3 3"]:
        """Diagonal blocks of the Hessian [N/m]; the negative curvature term of spheres is left out (stays definite)."""
        blocks = np.zeros((len(x), 3, 3))
        for obstacle, nodes, depth in self._touched(x, time):
            normals = obstacle.normals(x[nodes], time)
            stiffness = self.areas[nodes] * self.hinge(depth)[2]
            blocks[nodes] += stiffness[:, None, None] * normals[:, :, None] * normals[:, None, :]
        return blocks

    def freeze_friction(
        self, x: Float[np.ndarray, "V 3"], velocity: Float[np.ndarray, "V 3"], time: float
    ) -> tuple[Friction, ...]:
        """Friction linearised at positions x [m] and velocities [m/s], one entry per rough obstacle that is touched.

        The weight μ N f₁(|v_t|)/|v_t| makes the drag exact at the state where it is frozen, and its energy bounds the
        dissipation from above (f₀ is concave in |v_t|²), so re-freezing and solving again converges to Coulomb's law.
        """
        frozen = []
        for obstacle, nodes, depth in self._touched(x, time):
            part = Friction(nodes, self.areas[nodes], obstacle.normals(x[nodes], time), obstacle.velocity_at(time))
            if self.damping:
                frozen.append(self._dashpot(part, depth, velocity))
            if obstacle.friction:
                relative = np.linalg.norm(part.slip(velocity), axis=1) / self.slip_velocity
                # f₁(y)/y with f₁ = 2y − y² below one, 1 above
                ratio = np.where(relative < 1, 2 - relative, 1 / np.maximum(relative, 1.0))
                limits = obstacle.friction * self.areas[nodes] * self.hinge(depth)[1]
                frozen.append(replace(part, weights=limits * ratio / self.slip_velocity))
        return tuple(frozen)

    def _dashpot(self, touched: Friction, depth: np.ndarray, velocity: np.ndarray) -> Friction:
        """Normal damping, frozen like friction; it does not pull: on separating nodes it cancels the spring at most.

        Args:
            touched: with the areas of its nodes as weights.
            depth: of the nodes [m].
            velocity: of all nodes [m/s].
        """
        outwards = ((velocity[touched.nodes] - touched.velocity) * touched.normals).sum(1)
        _, slope, curvature = self.hinge(depth)
        weights = self.damping * curvature
        leaving = outwards > 0
        weights[leaving] = np.minimum(weights[leaving], slope[leaving] / outwards[leaving])
        return replace(touched, weights=weights * touched.weights, along_normal=True)

    def friction_energy_and_gradient(
        self, frozen: tuple[Friction, ...], velocity: Float[np.ndarray, "V 3"]
    ) -> tuple[float, Float[np.ndarray, "V 3"]]:
        """Rate potential ½ Σ w |v_t|² [W] and its derivative with respect to the node velocities [N]."""
        total, gradient = 0.0, np.zeros_like(velocity)
        for part in frozen:
            force = part.weights[:, None] * part.slip(velocity)
            total += 0.5 * float((force * part.slip(velocity)).sum())
            gradient[part.nodes] += force
        return total, gradient

    def friction_blocks(self, frozen: tuple[Friction, ...]) -> Float[np.ndarray, "V 3 3"]:
        """Second derivative of the rate potential, diagonal blocks [N·s/m]."""
        blocks = np.zeros((len(self.areas), 3, 3))
        for part in frozen:
            blocks[part.nodes] += part.weights[:, None, None] * part.projections
        return blocks
