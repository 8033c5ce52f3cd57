"""How far a body has come since it first touched something."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.gap.effects import Motion

__all__ = ["path_since_contact"]


def path_since_contact(motion: Motion, force: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """Length of the mean point's way from the last frame before the first contact to each frame [m]; 0 before.

    A model whose impact throws a body off by a hundredth too much is off by a hundredth of it from then on. (The
    distance from where the body would have fallen to says so too, but grows on for one that lies.)

    Args:
        motion: of points of the body.
        force: of contact in each frame [N].
    """
    touched = np.flatnonzero(force > 0)
    if not len(touched):
        return np.zeros(len(force))
    last = max(int(touched[0]) - 1, 0)  # of the fall
    steps = np.linalg.norm(np.diff(motion.positions.mean(1), axis=0), axis=1)
    steps[:last] = 0.0
    return np.concatenate([[0.0], np.cumsum(steps)])
