"""What residuals say of the base model and of the best effects: the numbers that a verdict is read from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.errors.rebound import forgiving
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.judgement.flight import gain_in_flight, left_in_flight
from physconvex.gap.search.evidence import mean_square
from physconvex.gap.search.hypothesis import Hypothesis, base_hypothesis
from physconvex.gap.search.ranking import evidence_of_anything
from physconvex.gap.shrinkage.how_far import HowFar

__all__ = ["Measured", "measure", "relative_gap"]


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
        flight: what the best effects gain before the first contact, see `physconvex.gap.judgement.flight`.
        flight_left: what the fit that leaves least of the flight leaves of it, mean square over the expected one, see
            `physconvex.gap.judgement.flight.left_in_flight`.
        forgiven: `after`, if a rebound as a whole may be off by three times as much, see
            `physconvex.gap.errors.rebound.forgiving`.
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
