"""Measures of residuals of the base model and of the best effects, on which a verdict depends.

Two programs with different meshes and contacts agree on a flight to within noise. After an impact they may differ by
many times the effect of a load on the flight, and this hides on held-out frames an effect that the flight shows
clearly. The gain and the remaining gap before the first contact are therefore measured separately.
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
    """Gain of log-likelihood by effects in the frames before the first contact, less ½ k ln n for their k doses.

    −∞ without a later contact, or if they leave more than noise and numerical error there (its last frame aside).
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
    """Least mean square of any fit before the first contact, over the expected one.

    The last frame before the contact does not count. 0 if residuals are not divided by contact (for held bodies, and
    for points that a video may lose).
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
    """The frame next to the first contact; an error of the clock or floor height turns it into a contact frame."""
    return int(base.observations.frames[~base.modes.struck[base.modes.kinds]].max())


@dataclass(frozen=True)
class Measured:
    """Measures of a base model and the best effects; the default of an unknown one changes nothing.

    Attributes:
        before: mean square of the base model's residual over its expected square, all frames.
        after: the same with the best effects; one = only noise and numerical error remain.
        share: share of the held-out gap above noise that the best effects remove, at most 1; can be negative.
        floor: numerical error and noise over the size of the body, or over its motion if that is less; a model with a
            floor of a tenth shows nothing.
        placebo: share of the held-out gap that the lowest-ranked effect removes; NaN if none is tried.
        above_error: share that they remove of the held-out gap above noise and numerical error; −inf if unknown.
        astray: distance of the best model from the recording over the motion of that, rms.
        other: evidence of an effect outside the hypotheses.
        struck: whether a free body strikes something; small causes then separate models.
        seen: gap of the base model on held-out frames over its expected size from noise and numerical error, rms.
        flight: gain of the best effects before the first contact, see `physconvex.gap.judgement.residual_measures`.
        flight_left: least mean square of any fit in flight over the expected one, see
            `physconvex.gap.judgement.residual_measures.left_in_flight`.
        forgiven: `after`, with three times the rigid error of a rebound, see
            `physconvex.gap.errors.error_model.forgiving`.
        reported: share that the best effects remove in the held-out frames reserved for the report.
        hurried: whether the clock ended the search before the trial of each top-ranked effect.
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
    base: Baseline, errors: ErrorModel, weights: ErrorModel, best: Hypothesis, hypotheses: Sequence[Hypothesis], *,
    shrinkage: Sequence[HowFar],
) -> Measured:  # fmt: skip
    """The measures of one capture.

    Args:
        base: the full-order base fit.
        errors, weights: errors of the residuals, and those for the choice between effects.
        best: the reported effects, or the base model.
        hypotheses: all fits.
        shrinkage: on the frames reserved for the report, and last on all held-out frames.
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
    """Reference length of a model error [m]: the size of the body, or its motion if that is less."""
    moved = base.motion.positions - base.motion.rest
    return float(np.clip(np.sqrt((moved**2).sum(-1).mean()), 1e-6 * base.situation.size, base.situation.size))


def _astray(base: Baseline, best: Hypothesis) -> float:
    """Distance of the best model from the observation over the motion of that, rms over all frames."""
    still = np.broadcast_to(base.motion.rest, base.positions.shape)
    left, moved = (float(np.linalg.norm(base.missed(x))) for x in (best.positions, still))
    return left / max(moved, 1e-12)
