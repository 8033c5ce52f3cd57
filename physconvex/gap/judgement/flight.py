"""What effects gain, and what they leave, before a body first touches anything.

A flight is simple: two programs that share neither mesh nor contact agree on it to within noise. What they part by
after an impact may then be many times what a load on the flight does, and hide on held-out frames what the flight shows
beyond doubt.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.search.evidence import information_by_kind, squares_by_kind
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.thresholds import VERDICT

__all__ = ["gain_in_flight", "left_in_flight"]


def gain_in_flight(base: Baseline, errors: ErrorModel, best: Hypothesis, plain: Hypothesis) -> float:
    """Log-likelihood of the frames before the first contact that effects gain, less ½ k ln n for their k doses.

    −∞ unless they leave nothing there but noise and numerical error, the last frame before the contact aside, or where
    no contact follows.

    Args:
        base: the base fit.
        errors: weights.
        best: the effects.
        plain: the base model.
    """
    fitted, struck = base.split.fitted, base.modes.struck
    information = information_by_kind(base, errors, fitted)
    flight = ~struck & (information > 0)
    if not flight.any() or not information[struck].any():
        return -np.inf
    seen = fitted[fitted < _last_of_flight(base)]
    left = squares_by_kind(base, errors, best.positions, seen)[flight]
    if np.isnan(left).all() or np.nanmax(left) > VERDICT.flight_closed:
        return -np.inf
    gain = ((best.likelihood - plain.likelihood) / best.divisor)[flight].sum()
    independent = (information / best.divisor)[flight].sum()
    doses = sum(len(effect.doses) for effect in best.effects)
    return float(gain - 0.5 * doses * np.log(max(float(independent), 2.0)))


def left_in_flight(base: Baseline, errors: ErrorModel, hypotheses: Sequence[Hypothesis]) -> float:
    """Least mean square, over the expected one, that any fit leaves before the first contact.

    Not in the last frame before it. 0 where residuals are not divided by contact (of held bodies, and of points that a
    video may lose).

    Args:
        base: the base fit.
        errors: of the residuals.
        hypotheses: all fits.
    """
    frames = base.observations.frames
    flying = ~base.modes.struck[base.modes.kinds]
    if not base.modes.reflections or not flying.any():
        return 0.0
    rows = np.flatnonzero(flying & (frames < _last_of_flight(base)))
    if not len(rows):
        return 0.0
    return float(min((base.residual(h.positions)[rows] ** 2 / errors.expected[rows]).mean() for h in hypotheses))


def _last_of_flight(base: Baseline) -> int:
    """The frame next to the first contact: with another clock, or a floor that is a little higher, it is struck."""
    return int(base.observations.frames[~base.modes.struck[base.modes.kinds]].max())
