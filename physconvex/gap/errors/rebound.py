"""How far a body has come since it first touched something, and how far a rebound may be off."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.gap.base.body_modes import BodyModes
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.thresholds import NUMERICAL_ERROR

__all__ = ["forgiving", "path_since_contact"]


def path_since_contact(motion: PointMotion, force: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
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


def forgiving(errors: ErrorModel, modes: BodyModes) -> ErrorModel:
    """Errors with which a body as a whole may be off by three times as much from the first contact on.

    Without any effect, what two programs part by as a whole after an impact came to .3 to 3 % of the way; a hundredth
    is what the evidence counts with.
    """
    whole = modes.struck & (modes.parts == 0)
    factor = np.where(whole[modes.kinds], NUMERICAL_ERROR.forgiven_rebound**2, 1.0)
    return ErrorModel(1 + factor * (errors.variance - 1), errors.directions, 1 + factor * (errors.expected - 1))
