"""What residuals say of the base model and of the best effects: the numbers that a verdict is read from.

A flight is simple: two programs that share neither mesh nor contact agree on it to within noise. What they part by
after an impact may be many times what a load on the flight does, and hide on held-out frames what the flight shows
beyond doubt. So what effects gain and leave before the first contact is measured by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.errors.error_model import forgiving
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.search.evidence import information_by_kind, mean_square, squares_by_kind
from physconvex.gap.search.hypothesis import Hypothesis, base_hypothesis, evidence_of_anything
from physconvex.gap.shrinkage import HowFar
from physconvex.gap.thresholds import VERDICT


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


@dataclass(frozen=True)
class Measured:
    """Of a base model and the best effects; what is not known has a default that changes nothing.

    Attributes:
        before: mean square of the base model's residual over its expected square, all frames.
        after: the same with the best effects; one = nothing left above noise and numerical error.
        share: of the held-out gap above noise that the best effects remove, up to 1; negative if they add to it.
        floor: numerical error and noise over the size of the body, or over its motion if that is less; a model that
            errs by a tenth of it tells nothing.
        placebo: share of the held-out gap that an effect removes which screening ranked last; NaN where none was tried.
        above_error: share that the best effects remove of the held-out gap above noise and numerical error; −inf where
            that is not known.
        astray: distance of the best model from the recording over how far that moves, rms.
        other: evidence of something that is not among the hypotheses.
        struck: whether a free body strikes something, after which models part for little.
        seen: gap of the base model on held-out frames over what noise and numerical error lead one to expect, rms.
        flight: what the best effects gain before the first contact, see `physconvex.gap.judgement.residual_measures`.
        flight_left: what the fit that leaves least of the flight leaves of it, mean square over the expected one, see
            `physconvex.gap.judgement.residual_measures.left_in_flight`.
        forgiven: `after`, if a rebound as a whole may be off by three times as much, see
            `physconvex.gap.errors.error_model.forgiving`.
        reported: the share that the best effects remove in those held-out frames that did not choose them.
        hurried: whether the clock ended the search before each effect that screening ranks first had been tried.
    """

    before: float
    after: float
    share: float
    floor: float = 0.0
    placebo: float = float("nan")
    above_error: float = float("-inf")
    astray: float = 0.0
    other: float = -np.inf
    struck: bool = False
    seen: float = np.inf
    flight: float = -np.inf
    flight_left: float = 0.0
    forgiven: float = np.inf
    reported: float = np.inf
    hurried: bool = False


def measure(
    base: Baseline,
    errors: ErrorModel,
    weights: ErrorModel,
    best: Hypothesis,
    hypotheses: Sequence[Hypothesis],
    *,
    shrinkage: Sequence[HowFar],
) -> Measured:
    """The numbers of one capture.

    Args:
        base: the full-order base fit.
        errors: of the residuals.
        weights: the same as they choose between effects.
        best: the effects that are reported, or the base model.
        hypotheses: all fits.
        shrinkage: on the frames that chose nothing, and last on all held-out frames.
    """
    held_out = shrinkage[-1]
    plain = next((h for h in hypotheses if not h.effects), best)
    return Measured(
        before=relative_gap(base, errors, base_hypothesis(base, errors)),
        after=relative_gap(base, errors, best),
        share=held_out.shrinkage,
        floor=held_out.noise_floor / _extent(base),
        placebo=held_out.placebo,
        above_error=held_out.above_error,
        astray=_astray(base, best),
        other=evidence_of_anything(best),
        struck=base.situation.touches and not base.situation.clamped,
        seen=held_out.gap_before / max(held_out.noise_floor, 1e-300),
        flight=gain_in_flight(base, weights, best, plain),
        flight_left=left_in_flight(base, errors, hypotheses),
        forgiven=relative_gap(base, forgiving(errors, base.modes), best),
        reported=shrinkage[0].shrinkage,
        hurried=base.model.cost.hurried,
    )


def relative_gap(base: Baseline, errors: ErrorModel, hypothesis: Hypothesis) -> float:
    """Mean square of the residuals over the expected one, all frames."""
    return mean_square(base, errors, hypothesis.positions, np.unique(base.observations.frames))


def _extent(base: Baseline) -> float:
    """What an error of the model is measured by [m]: the size of the body, or how far it moved if that is less."""
    moved = base.motion.positions - base.motion.rest
    return float(np.clip(np.sqrt((moved**2).sum(-1).mean()), 1e-6 * base.situation.size, base.situation.size))


def _astray(base: Baseline, best: Hypothesis) -> float:
    """Distance of the best model from what was seen over how far that moved, rms over all frames."""
    still = np.broadcast_to(base.motion.rest, base.positions.shape)
    left, moved = (float(np.linalg.norm(base.missed(x))) for x in (best.positions, still))
    return left / max(moved, 1e-12)
