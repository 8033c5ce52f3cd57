"""What effects gain before a body first touches anything.

A flight is simple: two programs that share neither mesh nor contact agree on it to within noise. What they part by
after an impact may then be many times what a load on the flight does, and hide on held-out frames what the flight shows
beyond doubt.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from physconvex.gap.baseline import Baseline
from physconvex.gap.comparison import Hypothesis
from physconvex.gap.evidence import information_by_kind, squares_by_kind
from physconvex.gap.score import ErrorModel

__all__ = ["IN_FLIGHT", "gain_in_flight"]

IN_FLIGHT = ("external", "initial state", "observation")  # sources of effects that need no contact to be seen
_CLOSED = 2.0  # mean square over the expected one up to which a flight is followed


def _in_flight(base: Baseline, errors: ErrorModel) -> Bool[np.ndarray, " D"]:
    """Kinds of residuals before the first contact; none where no contact follows in the fitted frames."""
    told = information_by_kind(base, errors, base.split.fitted) > 0
    return ~base.modes.struck & told & bool((base.modes.struck & told).any())


def _is_followed(base: Baseline, errors: ErrorModel, found: Hypothesis, flight: np.ndarray) -> bool:
    """Whether a fit leaves nothing of the flight but noise and numerical error."""
    squares = squares_by_kind(base, errors, found.positions, base.split.fitted)
    return bool(flight.any() and squares[flight].max() <= _CLOSED)


def gain_in_flight(base: Baseline, errors: ErrorModel, best: Hypothesis, plain: Hypothesis) -> float:
    """Log-likelihood of the frames before the first contact that effects gain, less ½ k ln n for their k doses.

    −∞ unless they leave nothing there but noise and numerical error, or where no contact follows.

    Args:
        base: the base fit.
        errors: weights.
        best: the effects.
        plain: the base model.
    """
    flight = _in_flight(base, errors)
    if not _is_followed(base, errors, best, flight):
        return -np.inf
    gain = ((best.likelihood - plain.likelihood) / best.divisor)[flight].sum()
    independent = (information_by_kind(base, errors, base.split.fitted) / best.divisor)[flight].sum()
    doses = sum(len(effect.doses) for effect in best.effects)
    return float(gain - 0.5 * doses * np.log(max(float(independent), 2.0)))
