"""Contact of nodes with planes and spheres: area-weighted C² hinge and smoothed, lagged Coulomb friction.

A node that carries the boundary area A and lies p = −gap deep in an obstacle has the energy A ψ(p), with

    ψ(p) = kc p³ / (6 ε)                    0 < p < ε
         = kc (p²/2 − p ε/2 + ε²/6)         p ≥ ε

so that pressure kc·p [Pa] is reached smoothly; kc [Pa/m] is a stiffness per area and does not change with the mesh.
Friction follows Li et al. 2020 (IPC), eq. 14: the dissipation μ N f₀(|v_t|) with f₀' = 1 above the velocity `v_s` and a
smooth ramp below, where N is the normal force and the tangent plane is frozen during a solve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError

__all__ = ["Contact", "Friction", "Obstacle", "Plane", "Sphere"]


def _vector(name: str, value: Sequence[float]) -> np.ndarray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{name}: got {value!r}; expected three finite numbers")
    return array


def _check_friction(friction: float) -> None:
    if not (np.isfinite(friction) and friction >= 0):
        raise InputError(f"friction: got {friction}; expected a finite coefficient ≥ 0")


@dataclass(frozen=True)
class Plane:
    """Half-space {x : (x − point(t))·normal < 0} that bodies may not enter.

    Attributes:
        point: a point on the plane at t = 0 [m].
        normal: outward direction, any length.
        friction: Coulomb coefficient [-].
        velocity: velocity of the plane [m/s]; a tangential part is a conveyor belt.
    """

    point: Sequence[float] = (0.0, 0.0, 0.0)
    normal: Sequence[float] = (0.0, 0.0, 1.0)
    friction: float = 0.0
    velocity: Sequence[float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("point", "normal", "velocity"):
            object.__setattr__(self, name, _vector(name, getattr(self, name)))
        length = np.linalg.norm(self.normal)
        if length == 0:
            raise InputError("normal: got the zero vector; expected a direction")
        object.__setattr__(self, "normal", np.asarray(self.normal) / length)
        _check_friction(self.friction)

    def gap(self, x: Float[np.ndarray, "V 3"], time: float) -> Float[np.ndarray, " V"]:
        """Signed distance [m], negative inside."""
        return (x - (np.asarray(self.point) + time * np.asarray(self.velocity))) @ np.asarray(self.normal)

    def normals(self, x: Float[np.ndarray, "V 3"], time: float) -> Float[np.ndarray, "V 3"]:
        """Gradient of the gap."""
        return np.broadcast_to(np.asarray(self.normal), x.shape)

    def curvature(self, x: Float[np.ndarray, "V 3"], time: float) -> Float[np.ndarray, " V"]:
        """Curvature of the level set [1/m]: the gap's Hessian is curvature × (I − n nᵀ)."""
        return np.zeros(len(x))


@dataclass(frozen=True)
class Sphere:
    """Solid sphere that bodies may not enter; `center` [m] at t = 0, `radius` [m], `velocity` [m/s]."""

    center: Sequence[float]
    radius: float
    friction: float = 0.0
    velocity: Sequence[float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("center", "velocity"):
            object.__setattr__(self, name, _vector(name, getattr(self, name)))
        if not (np.isfinite(self.radius) and self.radius > 0):
            raise InputError(f"radius: got {self.radius}; expected a length > 0 in metres")
        _check_friction(self.friction)

    def _offset(self, x: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        offset = x - (np.asarray(self.center) + time * np.asarray(self.velocity))
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


@dataclass(frozen=True)
class Friction:
    """Friction frozen for one solve: force limits and normals of the nodes in contact with one obstacle."""

    nodes: np.ndarray  # [C]
    limits: np.ndarray  # μ N [N], [C]
    normals: np.ndarray  # [C, 3]
    velocity: np.ndarray  # of the obstacle, [3]


@dataclass(frozen=True)
class Contact:
    """Contact law of one body with a list of obstacles.

    Attributes:
        obstacles: planes and spheres.
        areas: boundary area of each node [m²], zero for inner nodes, shape [V].
        stiffness: kc [Pa/m].
        smoothing: ε [m].
        slip_velocity: v_s [m/s], below which friction ramps to zero.
    """

    obstacles: tuple[Obstacle, ...]
    areas: Float[np.ndarray, " V"]
    stiffness: float
    smoothing: float
    slip_velocity: float
    nodes: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        for name in ("stiffness", "smoothing", "slip_velocity"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{name}: got {value}; expected a finite number > 0")
        object.__setattr__(self, "nodes", np.flatnonzero(self.areas > 0))

    def _hinge(self, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """ψ, ψ', ψ'' for the depths p > 0."""
        k, e = self.stiffness, self.smoothing
        soft = depth < e
        energy = np.where(soft, depth**3 / (6 * e), depth**2 / 2 - depth * e / 2 + e * e / 6)
        slope = np.where(soft, depth**2 / (2 * e), depth - e / 2)
        return k * energy, k * slope, k * np.where(soft, depth / e, 1.0)

    def _touching(self, obstacle: Obstacle, x: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        depth = -obstacle.gap(x[self.nodes], time)
        inside = depth > 0
        return self.nodes[inside], depth[inside]

    def energy_and_gradient(
        self, x: Float[np.ndarray, "V 3"], time: float
    ) -> tuple[float, Float[np.ndarray, "V 3"]]:
        """Contact energy [J] and its derivative [N]."""
        total, gradient = 0.0, np.zeros_like(x)
        for obstacle in self.obstacles:
            nodes, depth = self._touching(obstacle, x, time)
            if len(nodes):
                energy, slope, _ = self._hinge(depth)
                total += float(self.areas[nodes] @ energy)
                gradient[nodes] -= (self.areas[nodes] * slope)[:, None] * obstacle.normals(x[nodes], time)
        return total, gradient

    def hessian_blocks(self, x: Float[np.ndarray, "V 3"], time: float) -> Float[np.ndarray, "V 3 3"]:
        """Diagonal blocks of the Hessian [N/m]; the negative curvature term of spheres is left out (stays definite)."""
        blocks = np.zeros((len(x), 3, 3))
        for obstacle in self.obstacles:
            nodes, depth = self._touching(obstacle, x, time)
            if len(nodes):
                normals = obstacle.normals(x[nodes], time)
                stiffness = self.areas[nodes] * self._hinge(depth)[2]
                blocks[nodes] += stiffness[:, None, None] * normals[:, :, None] * normals[:, None, :]
        return blocks

    def freeze_friction(self, x: Float[np.ndarray, "V 3"], time: float) -> tuple[Friction, ...]:
        """Friction limits μN and normals at the state x, one entry per rough obstacle that is touched."""
        frozen = []
        for obstacle in self.obstacles:
            nodes, depth = self._touching(obstacle, x, time) if obstacle.friction else (np.empty(0, int), None)
            if len(nodes):
                limits = obstacle.friction * self.areas[nodes] * self._hinge(depth)[1]
                frozen.append(
                    Friction(nodes, limits, obstacle.normals(x[nodes], time), np.asarray(obstacle.velocity))
                )
        return tuple(frozen)

    def friction_energy_and_gradient(
        self, frozen: tuple[Friction, ...], velocity: Float[np.ndarray, "V 3"]
    ) -> tuple[float, Float[np.ndarray, "V 3"]]:
        """Dissipation [W] and its derivative with respect to the node velocities [N]."""
        total, gradient = 0.0, np.zeros_like(velocity)
        for part in frozen:
            tangent, speed, relative = self._slip(part, velocity)
            y = np.minimum(relative, 1.0)
            shape = np.where(relative < 1, y * y - y**3 / 3, relative - 1 / 3) * self.slip_velocity
            total += float(part.limits @ shape)
            gradient[part.nodes] += (part.limits * (2 * y - y * y) / speed)[:, None] * tangent
        return total, gradient

    def friction_blocks(
        self, frozen: tuple[Friction, ...], velocity: Float[np.ndarray, "V 3"]
    ) -> Float[np.ndarray, "V 3 3"]:
        """Second derivative of the dissipation with respect to the node velocities, diagonal blocks [N·s/m]."""
        blocks = np.zeros((len(velocity), 3, 3))
        for part in frozen:
            tangent, speed, relative = self._slip(part, velocity)
            y = np.minimum(relative, 1.0)
            along = part.limits * np.where(relative < 1, 2 - 2 * y, 0.0) / self.slip_velocity
            across = part.limits * (2 * y - y * y) / speed
            direction = tangent / speed[:, None]
            plane = np.eye(3) - part.normals[:, :, None] * part.normals[:, None, :]
            outer = direction[:, :, None] * direction[:, None, :]
            blocks[part.nodes] += across[:, None, None] * plane + (along - across)[:, None, None] * outer
        return blocks

    def _slip(self, part: Friction, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tangential velocity, its size (never zero), and the size over v_s."""
        relative = velocity[part.nodes] - part.velocity
        tangent = relative - (relative * part.normals).sum(1, keepdims=True) * part.normals
        speed = np.maximum(np.linalg.norm(tangent, axis=1), 1e-9 * self.slip_velocity)
        return tangent, speed, speed / self.slip_velocity
