"""True states of a simulated motion (`models.motion.STATE_NAMES`), and their rotation by a clip's augmentation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Float64

from models import STATE_NAMES

_SHIFT, _GRADIENT = slice(0, 3), slice(10, 19)
_TURNS = {"shift_x", "gradient_xy", "gradient_xz", "gradient_yx", "gradient_zx"}
MIRROR = np.array([-1.0 if name in _TURNS else 1.0 for name in STATE_NAMES], np.float32)
_OUTERMOST = 0.01  # share of the points left out below the lowest and above the highest


def states_of_motion(
    rest: Float[np.ndarray, "Q 3"],
    displacements: Float[np.ndarray, "T Q 3"],
    volume_weights: Float[np.ndarray, " Q"],
    *,
    height: float,
) -> Float32[np.ndarray, "T S"]:
    """States of points in the object frame, lengths over the object size.

    Args:
        rest: centred rest positions.
        displacements: from there.
        volume_weights: volume of each point.
        height: of the origin over the floor.
    """
    share = np.asarray(volume_weights, np.float64) / volume_weights.sum()
    now = rest[None] + np.asarray(displacements, np.float64)
    centre = np.einsum("q,tqi->ti", share, now)
    arms, rest_arms = now - centre[:, None], rest - share @ rest
    spread = np.einsum("q,qi,qj->ij", share, rest_arms, rest_arms)
    gradient = np.einsum("q,tqi,qj->tij", share, arms, rest_arms) @ np.linalg.inv(spread)
    bending = arms - np.einsum("tij,qj->tqi", gradient, rest_arms)
    lowest, highest = np.quantile(now[..., 2] + height, [_OUTERMOST, 1 - _OUTERMOST], axis=1)
    stretches = np.log(np.clip(np.linalg.svd(gradient, compute_uv=False), 0.1, 10))
    columns = [
        centre - centre[0],
        np.stack([lowest, highest - lowest], axis=1),
        stretches,
        stretches.sum(axis=1, keepdims=True),
        np.sqrt(np.einsum("q,tqi->t", share, bending**2))[:, None],
        (gradient - np.eye(3)).reshape(-1, 9),
    ]
    return referred_states(np.concatenate(columns, axis=1).astype(np.float32))


def referred_states(states: Float32[np.ndarray, "T S"]) -> Float32[np.ndarray, "T S"]:
    """Relative to the position and orientation of the first frame: F → F R₀ᵀ with its polar rotation R₀."""
    result = states.copy()
    result[:, _SHIFT] -= states[0, _SHIFT]
    gradient: Float64[np.ndarray, "T 3 3"] = states[:, _GRADIENT].reshape(-1, 3, 3).astype(np.float64) + np.eye(3)
    left, _, right = np.linalg.svd(gradient[0])
    result[:, _GRADIENT] = (gradient @ (left @ right).T - np.eye(3)).reshape(-1, 9)
    return result


def flipped_states(states: Float32[np.ndarray, "T S"]) -> Float32[np.ndarray, "T S"]:
    """Of the mirror image: x turns."""
    return states * MIRROR
