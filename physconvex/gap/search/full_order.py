"""The full-order model decides between fits that the reduced model found (space mapping).

A reduced run costs a tenth of a full-order one. What the two differ by at one set of values is added to the reduced
model, which is then searched; a full-order run at what was found gives the next difference, and so on, until the
values stay. The residual is thus always the full-order model's, the derivatives are the reduced model's.

Of bodies that strike something, each fit is corrected by the most exact run at its own values. What a finer mesh and
finer steps change is added to every run of a model (`physconvex.gap.errors.numerical_differences`), and is known at
the base fit. An effect turns a rebound elsewhere, where they change something else: with the base fit's correction,
the true effects leave up to four times what they leave after an impact with their own; wrong effects leave no more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.gap.base.baseline import Baseline, Report
from physconvex.gap.base.lowest_mode import decades_between
from physconvex.gap.base.model import MODULUS, EffectModel, reduced_like, searches_itself
from physconvex.gap.effects.motion import MotionCorrection, PointMotion
from physconvex.gap.errors.numerical_differences import Numerics, exact_model
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.options import GapOptions
from physconvex.gap.search.effect_fits import derivatives_at, refit
from physconvex.gap.search.evidence import squares_by_kind
from physconvex.gap.search.hypothesis import (
    Hypothesis,
    base_hypothesis,
    hypothesis_at,
    judged,
    weighed_anew,
)
from physconvex.gap.search.search_state import FAILURES, EffectSearch
from physconvex.gap.thresholds import CLOCK, DECISION


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
    return hypothesis_at(base, errors, full, values, found.errors, motion=full.motion(values), tangents=found.tangents)


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
            last = refit(base, errors, searched, here.values, tangents, options=options)
            tangents = last.tangents
            if np.abs((last.values - here.values) / scales).max() < DECISION.still:
                break
            motion = here.model.motion(last.values)
        except ConvergenceError:
            break
        here = hypothesis_at(base, errors, here.model, last.values, last.errors, motion=motion, tangents=last.tangents)
        if here.fitted > DECISION.diverged * best.fitted:
            break
        best = here if here.seen > best.seen else best
    return None if best is first else best


def with_own_correction(base: Baseline, errors: ErrorModel, numerics: Numerics, found: Hypothesis) -> Hypothesis:
    """A full-order fit with what the most exact run at its values changes; as it is where no such run is affordable.

    Args:
        base: the full-order base fit.
        errors: weights of the residuals.
        numerics: what the most exact run is made on.
        found: the fit, by the full-order model.

    Raises:
        ConvergenceError: the body cannot be simulated so, or the runs have cost what they may.
    """
    if numerics.exact is None:
        return found
    base.model.cost.check()
    exact = exact_model(found.model, numerics.exact[0])
    run = exact.motion(found.values)
    if run.steps is not None and found.motion.steps is not None:
        steps = PointMotion.of_steps(
            run.steps, len(found.motion.steps.times), exact.refinement // found.model.refinement
        )
        run = replace(run, steps=replace(steps, steps=None))
    model = replace(found.model, correction=MotionCorrection.between(run, found.motion))
    return hypothesis_at(base, errors, model, found.values, found.errors, motion=found.motion, tangents=found.tangents)


def fitted_there(search: EffectSearch, full: EffectModel, values: np.ndarray, *, by_kind: bool = False) -> Hypothesis:
    """A fit from values far from the base fit, by a reduced model that says what the full-order one does there.

    Args:
        search: for the base fit and the errors.
        full: the full-order model.
        values: where to begin.
        by_kind: residuals of each kind weigh by what is left of them there, which is what fits are compared by: what
            follows an impact, if no fit comes near it, does not draw doses away from what the flight says of them.
    """
    base, errors = search.base, search.errors
    cheap, motion = reduced_like(full, full.motion(values), values)
    tangents = derivatives_at(base, cheap, values, motion)
    if not by_kind:
        return refit(base, errors, cheap, values, tangents, options=search.options)
    left = squares_by_kind(base, errors, cheap.observed(motion, values), base.split.fitted)
    weights = replace(errors, variance=errors.variance * (1.0 + np.nan_to_num(left))[base.modes.kinds])
    return weighed_anew(base, errors, refit(base, weights, cheap, values, tangents, options=search.options))


def decided(
    base: Baseline, errors: ErrorModel, numerics: Numerics, chosen: Sequence[Hypothesis], *, options: GapOptions,
    report: Report,
) -> list[Hypothesis]:  # fmt: skip
    """The base model and the fits chosen, by the full-order model: as they were found, then fitted on while that helps.

    Each is corrected by the most exact run at its own values, the base model too, which is then fitted on as well.
    One for which there was no time is left out; if there was none for any, the reduced model's word is taken.
    """
    cost, plain = base.model.cost, base_hypothesis(base, errors)
    cost.allow(options.decision_cost, CLOCK.decision_ends)
    out = [plain]
    for hypothesis in sorted(chosen, key=lambda h: len(h.effects)):  # the simple ones first, should time run out
        report(f"full-order run: {hypothesis.label}")
        try:
            if len(out) > 1:
                cost.check()
            out.append(confirmed(base, errors, hypothesis))
        except FAILURES as error:
            report(f"full-order run: {hypothesis.label}: {error}")
    if numerics.exact is not None:
        near = {id(h.motion) for h in _near_the_best(base, errors, out)} | {id(plain.motion)}
        out = [_corrected(base, errors, numerics, h, report) if id(h.motion) in near else h for h in out]
        settled = {id(h.motion) for h in out} - near  # ids of motions
    else:
        settled = {id(plain.motion)}

    def better(found: Hypothesis) -> Hypothesis | None:
        report(f"full-order fit: {found.label}")
        try:
            further = improved(base, errors, found, options)
        except FAILURES as error:
            report(f"full-order fit: {found.label}: {error}")
            return None
        return None if further is None else _corrected(base, errors, numerics, further, report)

    out = fitted_while_it_helps(out, settled, better, lambda fits: judged(base, errors, fits))
    return out if len(out) > 1 else [*out, *chosen[:1]]


def fitted_while_it_helps(
    fits: Sequence[Hypothesis],
    settled: set[int],
    better: Callable[[Hypothesis], Hypothesis | None],
    ranked: Callable[[Sequence[Hypothesis]], list[Hypothesis]],
) -> list[Hypothesis]:
    """Sweeps over fits, best first and in turn, each fitted on while that gains enough.

    Args:
        fits: at first.
        settled: ids of the motions of fits that stay as they are.
        better: a fit that makes the fitted frames likelier; None where there is none.
        ranked: fits, best first.
    """
    out, settled = list(fits), set(settled)
    for _ in range(DECISION.sweeps):
        for hypothesis in [h for h in ranked(out) if id(h.motion) not in settled]:
            further = better(hypothesis)
            if further is None:
                settled.add(id(hypothesis.motion))
                continue
            out[next(i for i, h in enumerate(out) if h.motion is hypothesis.motion)] = further
            if further.seen < hypothesis.seen + DECISION.slow:
                settled.add(id(further.motion))
    return out


def _near_the_best(base: Baseline, errors: ErrorModel, fits: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Fits that may yet be the best, best first."""
    ranked = judged(base, errors, fits)
    return [h for h in ranked if h.evidence > ranked[0].evidence - DECISION.hopeless]


def _corrected(
    base: Baseline, errors: ErrorModel, numerics: Numerics, found: Hypothesis, report: Report
) -> Hypothesis:  # fmt: skip
    """A fit with its own correction, or as it is where that run fails, or has no time left."""
    try:
        return with_own_correction(base, errors, numerics, found)
    except FAILURES as error:
        report(f"most exact run: {found.label}: {error}")
        return found
