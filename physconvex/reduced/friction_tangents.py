"""Derivative of the frozen forces of friction and dashpots with respect to the state at which they are frozen.

`Contact.freeze_friction` fixes weights w = μ A ψ'(p) f₁(s)/s / v_s and normals n at positions x_f and velocities v_f, s
= |t_f|/v_s, t = (I − n nᵀ)(v − u); the force of the solve is then w t(v). A dashpot has w = τ A ψ''(p), for separating
points with the normal velocity v_n at most A ψ'(p)/v_n, and the force is w n nᵀ(v − u).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import Contact, Obstacle, Plane


@dataclass(frozen=True)
class FreezeTangent:
    """The state at which friction is frozen, and its derivatives by P parameters.

    Attributes:
        x: positions [m], shape [S, 3].
        v: velocities [m/s], shape [S, 3].
        time: [s].
        dx: derivatives of x, shape [P, S, 3].
        dv: derivatives of v, shape [P, S, 3].
        dlog_stiffness: derivative of ln kc, shape [P].
        dfriction: derivative of the friction coefficients, shape [P].
        ddamping: derivative of the dashpot's time τ [s], shape [P].
        drise: derivative of the height of planes [m], shape [P].
    """

    x: Float[np.ndarray, "S 3"]
    v: Float[np.ndarray, "S 3"]
    time: float
    dx: Float[np.ndarray, "P S 3"]
    dv: Float[np.ndarray, "P S 3"]
    dlog_stiffness: Float[np.ndarray, " P"]
    dfriction: Float[np.ndarray, " P"]
    ddamping: Float[np.ndarray, " P"]
    drise: Float[np.ndarray, " P"]


def friction_tangent(
    contact: Contact,
    frozen: FreezeTangent,
    velocity: Float[np.ndarray, "S 3"],
    dvelocity: Float[np.ndarray, "P S 3"],
) -> Float[np.ndarray, "P S 3"]:
    """Derivative of the forces of friction and dashpots [N per unit of parameter].

    Args:
        contact: the contact law.
        frozen: state at which friction is frozen.
        velocity: velocities at which the force is taken [m/s].
        dvelocity: their derivatives, without those that the Hessian of the solve includes.
    """
    out = np.zeros_like(dvelocity)
    for obstacle in contact.obstacles:
        nodes, depth = contact.touching(obstacle, frozen.x, frozen.time)
        if not len(nodes):
            continue
        here = _Touching(obstacle, nodes, depth, frozen)
        now, dnow = velocity[nodes] - here.belt, dvelocity[:, nodes]
        if obstacle.friction:
            out[:, nodes] += _rubbed(contact, here, now, dnow)
        if contact.damping:
            out[:, nodes] += _damped(contact, here, now, dnow)
    return out


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(-1, keepdims=True)


class _Touching:
    """Points in contact in the state at which friction is frozen, and their derivatives by the parameters.

    Attributes:
        nodes, depth: their indices, and p [m].
        friction, belt: coefficient of the obstacle, and its velocity [m/s].
        normals, dnormals: n and its derivatives.
        dx: derivatives of the positions, relative to a plane that rises.
        slip, dslip: velocity over the belt, and the derivatives of the points' velocities.
        frozen: state at which friction is frozen.
    """

    def __init__(self, obstacle: Obstacle, nodes: np.ndarray, depth: np.ndarray, frozen: FreezeTangent) -> None:
        self.nodes, self.depth, self.friction, self.frozen = nodes, depth, obstacle.friction, frozen
        x, time = frozen.x[nodes], frozen.time
        self.normals, self.belt, self.dx = obstacle.normals(x, time), obstacle.velocity_at(time), frozen.dx[:, nodes]
        if isinstance(obstacle, Plane):
            self.dx = self.dx - frozen.drise[:, None, None] * self.normals
        across = self.dx - self.normals * _dot(self.normals, self.dx)
        self.dnormals = obstacle.curvature(x, time)[:, None] * across
        self.slip, self.dslip = frozen.v[nodes] - self.belt, frozen.dv[:, nodes]


def _rubbed(contact: Contact, here: _Touching, now: np.ndarray, dnow: np.ndarray) -> np.ndarray:
    """Of friction, at velocities over the belt and their derivatives."""
    n, dn = here.normals, here.dnormals

    def tangential(u: np.ndarray) -> np.ndarray:
        return u - n * _dot(n, u)

    def turned(u: np.ndarray) -> np.ndarray:
        """Change of the tangential part by that of the normal."""
        return -dn * _dot(n, u) - n * _dot(dn, u)

    slip = tangential(here.slip)
    speed = np.linalg.norm(slip, axis=1, keepdims=True)
    dslip = tangential(here.dslip) + turned(here.slip)
    s = speed / contact.slip_velocity
    ds = _dot(slip, dslip) / (np.maximum(speed, 1e-300) * contact.slip_velocity)
    ratio, slope = np.where(s < 1, 2 - s, 1 / np.maximum(s, 1)), np.where(s < 1, -1.0, -1 / np.maximum(s, 1) ** 2)
    _, pressure, stiffness = (contact.areas[here.nodes] * h for h in contact.hinge(here.depth))  # A ψ', A ψ''
    unit = pressure[:, None] * ratio / contact.slip_velocity  # weight per friction coefficient
    dunit = (-stiffness[:, None] * _dot(n, here.dx) * ratio + pressure[:, None] * slope * ds) / contact.slip_velocity
    dunit = dunit + unit * here.frozen.dlog_stiffness[:, None, None]
    dweight = here.friction * dunit + unit * here.frozen.dfriction[:, None, None]
    return dweight * tangential(now) + here.friction * unit * (turned(now) + tangential(dnow))


def _damped(contact: Contact, here: _Touching, now: np.ndarray, dnow: np.ndarray) -> np.ndarray:
    """Of dashpots, at velocities over the belt and their derivatives."""
    n, dn = here.normals, here.dnormals
    outwards = _dot(n, here.slip)
    doutwards = _dot(n, here.dslip) + _dot(dn, here.slip)
    _, pressure, stiffness = (h[:, None] for h in contact.hinge(here.depth))
    bend = np.where(here.depth < contact.smoothing, contact.stiffness / contact.smoothing, 0.0)[:, None]  # ψ'''
    ddepth = -_dot(n, here.dx)
    free = contact.damping * stiffness
    dfree = contact.damping * bend * ddepth + stiffness * here.frozen.ddamping[:, None, None]
    apart = np.maximum(outwards, 1e-30)
    most = pressure / apart
    held = (outwards > 0) & (most < free)
    weight = np.where(held, most, free)
    dweight = np.where(held, stiffness * ddepth / apart - most * doutwards / apart, dfree)
    dweight = dweight + weight * here.frozen.dlog_stiffness[:, None, None]
    along = _dot(n, now)
    dalong = _dot(dn, now) + _dot(n, dnow)
    return contact.areas[here.nodes][:, None] * (dweight * n * along + weight * (dn * along + n * dalong))
