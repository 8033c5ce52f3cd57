"""What the frames tell before a body first touches anything.

A flight is simple: two programs that share neither mesh nor contact agree on it to within noise. What they part by
after an impact may then be many times what a load on the flight does, and hide on held-out frames what the flight shows
beyond doubt; and a fit to all frames bends the flight towards a rebound that it cannot follow.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from physconvex.gap.baseline import Baseline
from physconvex.gap.comparison import Hypothesis, hypothesis_at, refit
from physconvex.gap.evidence import information_by_kind, squares_by_kind
from physconvex.gap.model import reduced_like
from physconvex.gap.options import GapOptions
from physconvex.gap.score import ErrorModel

__all__ = ["IN_FLIGHT", "fitted_to_the_flight", "gain_in_flight"]

IN_FLIGHT = ("external", "initial state", "observation")  # sources of effects that need no contact to be seen
_CLOSED = 2.0  # mean square over the expected one up to which a flight is followed
_LIGHT = 100.0  # factor on the variance of what follows the first contact


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


def fitted_to_the_flight(
    base: Baseline, errors: ErrorModel, found: Hypothesis, options: GapOptions
) -> Hypothesis | None:  # fmt: skip
    """A fit in which what follows the first contact counts for little, if the evidence of all frames is for it.

    None where it is not, where the flight is followed already, or where no effect acts on it.

    Raises:
        ConvergenceError: the body cannot be simulated at the start.
    """
    flight = _in_flight(base, errors)
    acts = any(effect.source in IN_FLIGHT for effect in found.effects)
    if not (acts and flight.any()) or _is_followed(base, errors, found, flight):
        return None
    factor = np.where(base.modes.struck, _LIGHT, 1.0)[base.modes.kinds]
    light = ErrorModel(factor * errors.variance, errors.directions, factor * errors.expected)
    model, _ = reduced_like(found.model, found.motion, found.values)
    last = refit(base, light, model, found.values, found.tangents, options)
    motion = found.model.motion(last.values)
    other = hypothesis_at(base, errors, found.model, last.values, last.errors, motion, last.tangents)
    return other if other.evidence > found.evidence else None
