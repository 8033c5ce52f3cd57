"""The rotation that lays one set of points best on another."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

__all__ = ["best_rotation", "beyond_rigid"]


def best_rotation(
    start: Float[np.ndarray, "V 3"], now: Float[np.ndarray, "V 3"], weights: Float[np.ndarray, " V"] | None = None
) -> Float[np.ndarray, "3 3"]:
    """R with now − c' ≈ R (start − c), c and c' the centres (Kabsch 1976); points in a line leave a turn about it open.

    Args:
        start, now: the points [m].
        weights: of the points; alike unless given.
    """
    shares = np.full(len(start), 1 / len(start)) if weights is None else weights / weights.sum()
    a, b = start - shares @ start, now - shares @ now
    u, _, vt = np.linalg.svd(b.T @ (a * shares[:, None]))
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)


def beyond_rigid(
    rest: Float[np.ndarray, "P 3"], positions: Float[np.ndarray, "T P 3"]
) -> tuple[Float[np.ndarray, "T P 3"], Float[np.ndarray, "T 3 3"]]:
    """What points have moved by beyond the best rigid motion of each frame, in space, and its rotations.

    Args:
        rest: the points at rest [m].
        positions: in each frame [m].
    """
    turns = np.stack([best_rotation(rest, now) for now in positions])
    turned = (rest - rest.mean(0)) @ turns.transpose(0, 2, 1)
    return positions - positions.mean(1, keepdims=True) - turned, turns
