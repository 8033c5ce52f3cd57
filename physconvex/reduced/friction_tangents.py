"""Derivative of the frozen forces of friction and dashpots with respect to the state they were frozen at.

`Contact.freeze_friction` fixes weights w = μ A ψ'(p) f₁(s)/s / v_s and normals n at positions x_f and velocities v_f,
s = |t_f|/v_s, t = (I − n nᵀ)(v − u); the force of the solve is then w t(v). Of a dashpot w = τ A ψ''(p), of
points that leave with the normal velocity v_n at most A ψ'(p)/v_n, and the force is w n nᵀ(v − u).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import Contact, Obstacle

__all__ = ["FreezeTangent", "friction_tangent"]


@dataclass(frozen=True)
class FreezeTangent:
    """Where friction was frozen, and how that moves with P parameters.

    Attributes:
        x: positions [m], shape [S, 3].
        v: velocities [m/s], shape [S, 3].
        time: [s].
        dx: derivatives of x, shape [P, S, 3].
        dv: derivatives of v, shape [P, S, 3].
        dlog_stiffness: derivative of ln kc, shape [P].
        dfriction: derivative of the friction coefficients, shape [P].
        ddamping: derivative of the dashpot's time τ [s], shape [P].
    """

    x: Float[np.ndarray, "S 3"]
    v: Float[np.ndarray, "S 3"]
    time: float
    dx: Float[np.ndarray, "P S 3"]
    dv: Float[np.ndarray, "P S 3"]
    dlog_stiffness: Float[np.ndarray, " P"]
    dfriction: Float[np.ndarray, " P"]
    ddamping: Float[np.ndarray, " P"]


def friction_tangent(
    contact: Contact,
    frozen: FreezeTangent,
    velocity: Float[np.ndarray, "S 3"],
    dvelocity: Float[np.ndarray, "P S 3"],
) -> Float[np.ndarray, "P S 3"]:
    """Derivative of the forces of friction and dashpots [N per unit of parameter].

    Args:
        contact: the contact law.
        frozen: where friction was frozen.
        velocity: velocities at which the force is taken [m/s].
        dvelocity: their derivatives; leave out of them what the Hessian of the solve accounts for.
    """
    out = np.zeros_like(dvelocity)
    for obstacle in contact.obstacles:
        nodes, depth = contact.touching(obstacle, frozen.x, frozen.time)
        if not len(nodes):
            continue
        if obstacle.friction:
            out[:, nodes] += _of_obstacle(contact, obstacle, frozen, nodes, depth, velocity, dvelocity)
        if contact.damping:
            out[:, nodes] += _of_dashpot(contact, obstacle, frozen, nodes, depth, velocity, dvelocity)
    return out


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(-1, keepdims=True)


def _normals(obstacle: Obstacle, frozen: FreezeTangent, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals at some points, their derivatives, and those of the positions."""
    x, dx = frozen.x[nodes], frozen.dx[:, nodes]
    n = obstacle.normals(x, frozen.time)
    return n, obstacle.curvature(x, frozen.time)[:, None] * (dx - n * _dot(n, dx)), dx


def _of_obstacle(
    contact: Contact,
    obstacle: Obstacle,
    frozen: FreezeTangent,
    nodes: np.ndarray,
    depth: np.ndarray,
    velocity: np.ndarray,
    dvelocity: np.ndarray,
) -> np.ndarray:
    n, dn, dx = _normals(obstacle, frozen, nodes)

    def tangential(u: np.ndarray) -> np.ndarray:
        return u - n * _dot(n, u)

    def turned(u: np.ndarray) -> np.ndarray:
        """Change of the tangential part with the normal."""
        return -dn * _dot(n, u) - n * _dot(dn, u)

    belt = obstacle.velocity_at(frozen.time)
    slip = tangential(frozen.v[nodes] - belt)
    speed = np.linalg.norm(slip, axis=1, keepdims=True)
    dslip = tangential(frozen.dv[:, nodes]) + turned(frozen.v[nodes] - belt)
    s = speed / contact.slip_velocity
    ds = _dot(slip, dslip) / (np.maximum(speed, 1e-300) * contact.slip_velocity)
    ratio, slope = np.where(s < 1, 2 - s, 1 / np.maximum(s, 1)), np.where(s < 1, -1.0, -1 / np.maximum(s, 1) ** 2)
    _, pressure, stiffness = (contact.areas[nodes] * h for h in contact.hinge(depth))  # A ψ', A ψ''
    unit = pressure[:, None] * ratio / contact.slip_velocity  # weight per friction coefficient
    dunit = (-stiffness[:, None] * _dot(n, dx) * ratio + pressure[:, None] * slope * ds) / contact.slip_velocity
    dunit = dunit + unit * frozen.dlog_stiffness[:, None, None]
    dweight = obstacle.friction * dunit + unit * frozen.dfriction[:, None, None]
    now = velocity[nodes] - belt
    moved = turned(now) + tangential(dvelocity[:, nodes])
    return dweight * tangential(now) + obstacle.friction * unit * moved


def _of_dashpot(
    contact: Contact,
    obstacle: Obstacle,
    frozen: FreezeTangent,
    nodes: np.ndarray,
    depth: np.ndarray,
    velocity: np.ndarray,
    dvelocity: np.ndarray,
) -> np.ndarray:
    n, dn, dx = _normals(obstacle, frozen, nodes)
    belt = obstacle.velocity_at(frozen.time)
    outwards = _dot(n, frozen.v[nodes] - belt)
    doutwards = _dot(n, frozen.dv[:, nodes]) + _dot(dn, frozen.v[nodes] - belt)
    _, pressure, stiffness = (h[:, None] for h in contact.hinge(depth))
    bend = np.where(depth < contact.smoothing, contact.stiffness / contact.smoothing, 0.0)[:, None]  # ψ'''
    ddepth = -_dot(n, dx)
    free = contact.damping * stiffness
    dfree = contact.damping * bend * ddepth + stiffness * frozen.ddamping[:, None, None]
    apart = np.maximum(outwards, 1e-30)
    most = pressure / apart
    held = (outwards > 0) & (most < free)
    weight = np.where(held, most, free)
    dweight = np.where(held, stiffness * ddepth / apart - most * doutwards / apart, dfree)
    dweight = dweight + weight * frozen.dlog_stiffness[:, None, None]
    now = velocity[nodes] - belt
    along = _dot(n, now)
    dalong = _dot(dn, now) + _dot(n, dvelocity[:, nodes])
    return contact.areas[nodes][:, None] * (dweight * n * along + weight * (dn * along + n * dalong))
