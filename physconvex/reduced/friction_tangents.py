"""Derivative of the frozen friction force with respect to the state it was frozen at.

`Contact.freeze_friction` fixes weights w = μ A ψ'(p) f₁(s)/s / v_s and normals n at positions x_f and velocities v_f,
s = |t_f|/v_s, t = (I − n nᵀ)(v − u); the force of the solve is then w t(v).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.contact import Contact, Obstacle

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
    """

    x: Float[np.ndarray, "S 3"]
    v: Float[np.ndarray, "S 3"]
    time: float
    dx: Float[np.ndarray, "P S 3"]
    dv: Float[np.ndarray, "P S 3"]
    dlog_stiffness: Float[np.ndarray, " P"]
    dfriction: Float[np.ndarray, " P"]


def friction_tangent(
    contact: Contact,
    frozen: FreezeTangent,
    velocity: Float[np.ndarray, "S 3"],
    dvelocity: Float[np.ndarray, "P S 3"],
) -> Float[np.ndarray, "P S 3"]:
    """Derivative of the friction force [N per unit of parameter].

    Args:
        contact: the contact law.
        frozen: where friction was frozen.
        velocity: velocities at which the force is taken [m/s].
        dvelocity: their derivatives; leave out of them what the Hessian of the solve accounts for.
    """
    out = np.zeros_like(dvelocity)
    for obstacle in contact.obstacles:
        if obstacle.friction:
            nodes, depth = contact._touching(obstacle, frozen.x, frozen.time)
            if len(nodes):
                out[:, nodes] += _of_obstacle(contact, obstacle, frozen, nodes, depth, velocity, dvelocity)
    return out


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(-1, keepdims=True)


def _of_obstacle(
    contact: Contact,
    obstacle: Obstacle,
    frozen: FreezeTangent,
    nodes: np.ndarray,
    depth: np.ndarray,
    velocity: np.ndarray,
    dvelocity: np.ndarray,
) -> np.ndarray:
    x, dx = frozen.x[nodes], frozen.dx[:, nodes]
    n = obstacle.normals(x, frozen.time)
    dn = obstacle.curvature(x, frozen.time)[:, None] * (dx - n * _dot(n, dx))

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
