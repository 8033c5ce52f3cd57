"""Two models of one twin: the reduced one searches, the full-order one decides (space mapping).

A reduced run costs a tenth of a full-order one. What the two differ by at one set of values is added to the reduced
model, which is then searched; a full-order run at what was found gives the next difference, and so on, until the values
stay. The residual is thus always the full-order model's, the derivatives are the reduced model's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.gap.base.baseline import Baseline
from physconvex.gap.base.lowest_mode import decades_between
from physconvex.gap.base.model import MODULUS, EffectModel, reduced_like, searches_itself
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.options import GapOptions
from physconvex.gap.search.effect_fits import derivatives_at, refit
from physconvex.gap.search.hypothesis import Hypothesis, hypothesis_at
from physconvex.gap.thresholds import DECISION

__all__ = ["as_reduced", "confirmed", "improved"]


def as_reduced(base: Baseline) -> Baseline:
    """The baseline with the reduced model in the place of the full-order one; it says the same at the fit."""
    model, motion = reduced_like(base.model, base.motion, base.fit.values)
    return replace(base, model=model, motion=motion)


def confirmed(base: Baseline, errors: ErrorModel, found: Hypothesis) -> Hypothesis:
    """What a fit of the reduced model is worth by the full-order one.

    Args:
        base: the full-order base fit.
        errors: weights of the residuals.
        found: what the reduced model came to.

    Raises:
        ConvergenceError: the full-order model cannot be run there.
    """
    full = replace(base.model, effects=found.model.effects)
    values = _in_step(base, full, found)
    return hypothesis_at(base, errors, full, values, found.errors, full.motion(values), found.tangents)


def _in_step(base: Baseline, full: EffectModel, found: Hypothesis) -> np.ndarray:
    """Values with which a held body swings on the full-order model's mesh as it did on the one that found them.

    The two differ at the base fit already, which the search makes up for. What an effect adds to that, as an
    inclusion does that few elements resolve, is taken up by E: else the motions are soon out of step.
    """
    if not base.situation.clamped or MODULUS not in full.base or searches_itself(full):
        return found.values
    count = len(full.base)
    cheap = replace(found.model, effects=())
    ratio = decades_between(found.model, full, found.values)
    values = found.values.copy()
    values[full.base.index(MODULUS)] += ratio - decades_between(cheap, base.model, base.fit.values[:count])
    return values


def _saturates(model: EffectModel) -> bool:
    """Whether a dose of its effects does nothing beyond a threshold.

    The reduced model's stresses are others, so that it saturates at another dose: no motion that is added to it makes
    up for that, and such a fit is searched with the full-order model itself.
    """
    return any(dose.threshold for effect in model.effects for dose in effect.doses)


def improved(base: Baseline, errors: ErrorModel, here: Hypothesis, options: GapOptions) -> Hypothesis | None:
    """A better fit of the full-order model, searched with the reduced one about the one that is there.

    What saturates is searched with the full-order model itself. Better is what makes the fitted frames likelier. None
    where there is none.
    """
    scales = np.array([p.step for p in here.model.parameters(here.values)])
    first = best = here
    saturates = _saturates(here.model)
    tangents: np.ndarray | None = None
    for _ in range(DECISION.rounds):
        try:
            base.model.cost.check()
            searched = here.model
            if tangents is None or not saturates:
                cheap, own = reduced_like(here.model, here.motion, here.values)
                tangents = derivatives_at(base, cheap, here.values, own) if tangents is None else tangents
                searched = here.model if saturates else cheap
            last = refit(base, errors, searched, here.values, tangents, options)
            tangents = last.tangents
            if np.abs((last.values - here.values) / scales).max() < DECISION.still:
                break
            motion = here.model.motion(last.values)
        except ConvergenceError:
            break
        here = hypothesis_at(base, errors, here.model, last.values, last.errors, motion, last.tangents)
        if here.fitted > DECISION.diverged * best.fitted:
            break
        best = here if here.seen > best.seen else best
    return None if best is first else best
