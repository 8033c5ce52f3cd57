"""Contact and friction of a point behind a spring: the force of the law of `Contact` on a point that can yield.

The contact force λ displaces a point by −λ/ρ, where ρ is the stiffness of its support. Closed forms decide between
sticking, slipping and separating from the place z' of the point without the force, since both the hinge and the
smoothed law of friction are piecewise quadratic and linear. This is the projection of augmented Lagrangians of contact
(Alart and Curnier 1991), for a compliant law.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.dynamics.contact import Contact

_TINY = 1e-300


@dataclass(frozen=True)
class Resolved:
    """Forces λ, as gradients [N], shape [C, 3], and their derivative by z' [N/m], shape [C, 3, 3]."""

    force: Float[np.ndarray, "C 3"]
    slope: Float[np.ndarray, "C 3 3"]


def resolve(
    law: Contact,
    friction: float,
    *,
    areas: Float[np.ndarray, " C"],
    normals: Float[np.ndarray, "C 3"],
    depth: Float[np.ndarray, " C"],
    slip: Float[np.ndarray, "C 3"],
    stiffness: Float[np.ndarray, " C"],
    step: float,
) -> Resolved:
    """Forces of one obstacle on C points, from their depth and slip without the forces.

    Args:
        law: of contact.
        friction: coefficient of the obstacle.
        areas: of the points [m²].
        normals: of the obstacle.
        depth: of z' [m]; negative without contact.
        slip: tangential velocity at z' relative to the obstacle [m/s].
        stiffness: ρ [N/m].
        step: derivative of positions by velocities [s].
    """
    push, rise = _normal(law, areas, depth, stiffness)
    hold, by_speed, by_push, ratio = _tangential(law, friction, push, np.linalg.norm(slip, axis=1), stiffness * step)
    along = slip / np.maximum(np.linalg.norm(slip, axis=1), _TINY)[:, None]
    across = normals[:, :, None] * normals[:, None, :]
    straight = along[:, :, None] * along[:, None, :]
    sideways = np.eye(3) - across - straight
    slope = rise[:, None, None] * across - (by_push * rise)[:, None, None] * along[:, :, None] * normals[:, None, :]
    slope += (by_speed[:, None, None] * straight + ratio[:, None, None] * sideways) / step
    return Resolved(hold[:, None] * along - push[:, None] * normals, slope)


def _normal(law: Contact, areas: np.ndarray, depth: np.ndarray, stiffness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal force A ψ'(p) at the final depth p, p + A ψ'(p)/ρ = depth, and its derivative by the depth."""
    e, full = law.smoothing, law.stiffness * areas
    ratio, depth = full / stiffness, np.maximum(depth, 0.0)
    soft = depth < e + 0.5 * ratio * e
    in_ramp = 2 * depth / (1 + np.sqrt(1 + 2 * ratio * depth / e))
    left = np.where(soft, in_ramp, (depth + 0.5 * ratio * e) / (1 + ratio))
    _, push, rise = law.hinge(left)
    push, rise = areas * push, areas * rise
    return push, rise / (1 + rise / stiffness)


def _tangential(
    law: Contact, friction: float, push: np.ndarray, speed: np.ndarray, resistance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Friction μ N f₁(s) at the final speed s, s + μ N f₁(s)/r = speed, f₁ as in `Contact`.

    Its derivatives by the speed and by the normal force N = `push`, and its ratio to the speed.
    """
    v, most = law.slip_velocity, friction * push
    slows = most / resistance  # [m/s]
    steep = 1 + 2 * slows / v
    root = np.sqrt(np.maximum(steep**2 - 4 * slows * speed / v**2, 0.0))
    left = np.where(speed >= v + slows, speed - slows, 2 * speed / (steep + root))
    y = np.minimum(left / v, 1.0)
    share = 2 * y - y * y
    bend = 1 + slows * (2 - 2 * y) / v
    hold = most * share
    ratio = np.where(speed > 1e-12 * v, hold / np.maximum(speed, _TINY), 2 * most / v / steep)
    return hold, resistance * (1 - 1 / bend), friction * share / bend, ratio
