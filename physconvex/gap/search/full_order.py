"""The full-order model decides between fits of the reduced model (space mapping).

A reduced run costs a tenth of a full-order one. The difference of the two at one set of values corrects the reduced
model, which is then searched. A full-order run at the result gives the next difference, until the values converge. The
residual is always the full-order model's, the derivatives are the reduced model's.

For bodies that strike something, the most exact run at its own values corrects each fit. The correction for a finer
mesh and finer steps (`physconvex.gap.errors.numerical_differences`) is part of every run, but belongs to the base fit.
An effect changes the rebound and thus the correction. With the base fit's correction, the true effects leave up to four
times the residual after an impact that they leave with their own; wrong effects gain nothing from their own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.gap.base.baseline import Baseline, Report
from physconvex.gap.base.model import MODULUS, EffectModel, decades_between, reduced_like, searches_itself
from physconvex.gap.effects.motion import MotionCorrection, PointMotion
from physconvex.gap.errors.numerical_differences import Numerics, exact_model
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.options import GapOptions
from physconvex.gap.search.effect_fits import derivatives_at, refit
from physconvex.gap.search.evidence import squares_by_kind
from physconvex.gap.search.hypothesis import Hypothesis, base_hypothesis, hypothesis_at, judged, weighed_anew
from physconvex.gap.search.search_state import FAILURES, EffectSearch
from physconvex.gap.thresholds import CLOCK, DECISION


def as_reduced(base: Baseline) -> Baseline:
    """The baseline with the reduced model in place of the full-order one; both agree at the fit."""
    model, motion = reduced_like(base.model, base.motion, base.fit.values)
    return replace(base, model=model, motion=motion)


def confirmed(base: Baseline, errors: ErrorModel, found: Hypothesis) -> Hypothesis:
    """A fit of the reduced model, evaluated by the full-order one.

    Raises:
        ConvergenceError: the full-order model cannot be run there.
    """
    full = replace(base.model, effects=found.model.effects)
    values = _in_step(base, full, found)
    return hypothesis_at(base, errors, full, values, found.errors, motion=full.motion(values), tangents=found.tangents)


def _in_step(base: Baseline, full: EffectModel, found: Hypothesis) -> np.ndarray:
    """Values that give a held body on the full-order model's mesh the vibration of the mesh that found them.

    The search corrects the difference of the two at the base fit. A further difference by an effect, such as an
    inclusion that few elements resolve, changes E; otherwise the motions soon get out of phase.
    """
    if not base.situation.clamped or MODULUS not in full.base or searches_itself(full):
        return found.values
    count = len(full.base)
    cheap = replace(found.model, effects=())
    ratio = decades_between(found.model, full, found.values)
    values = found.values.copy()
    values[full.base.index(MODULUS)] += ratio - decades_between(cheap, base.model, base.fit.values[:count])
    return values


def improved(base: Baseline, errors: ErrorModel, here: Hypothesis, options: GapOptions) -> Hypothesis | None:
    """A fit of the full-order model with a higher likelihood, searched with the reduced one near the current one.

    None if no fit is better. An effect saturates if its dose does nothing beyond a threshold. The reduced model has
    other stresses and saturates at another dose. No added motion corrects that, so the full-order model itself searches
    such a fit.
    """
    scales = np.array([p.step for p in here.model.parameters(here.values)])
    first = best = here
    saturates = any(dose.threshold for effect in here.model.effects for dose in effect.doses)
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
    """A full-order fit, corrected by the most exact run at its values; unchanged if no such run is affordable.

    Raises:
        ConvergenceError: the body cannot be simulated so, or the runs have used their budget.
    """
    if numerics.exact is None:
        return found
    base.model.cost.check()
    exact = exact_model(found.model, numerics.exact[0])
    run = exact.motion(found.values)
    if run.steps is not None and found.motion.steps is not None:
        every = exact.refinement // found.model.refinement
        steps = PointMotion.of_steps(run.steps, len(found.motion.steps.times), every)
        run = replace(run, steps=replace(steps, steps=None))
    model = replace(found.model, correction=MotionCorrection.between(run, found.motion))
    return hypothesis_at(base, errors, model, found.values, found.errors, motion=found.motion, tangents=found.tangents)


def fitted_there(search: EffectSearch, full: EffectModel, values: np.ndarray, *, by_kind: bool = False) -> Hypothesis:
    """A fit from values far from the base fit, by a reduced model that is corrected to the full-order one there.

    With `by_kind`, residuals of each kind are weighted by their size there, as in the comparison of fits. A poor fit
    after an impact then does not distort the doses that the flight determines.
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
    """The base model and the chosen fits, evaluated by the full-order model and refined while that helps.

    The most exact run at its own values corrects each fit, the base model too, which is also refined. Fits without
    remaining time are left out; if none has time, the reduced model's results are returned.
    """

    def corrected(found: Hypothesis) -> Hypothesis:
        """The fit with its own correction, or unchanged if that run fails or has no time left."""
        try:
            return with_own_correction(base, errors, numerics, found)
        except FAILURES as error:
            report(f"most exact run: {found.label}: {error}")
            return found

    cost, plain = base.model.cost, base_hypothesis(base, errors)
    cost.allow(options.decision_cost, CLOCK.decision_ends)
    out = [plain]
    for hypothesis in sorted(chosen, key=lambda h: len(h.effects)):  # simple ones first, in case time runs out
        report(f"full-order run: {hypothesis.label}")
        try:
            if len(out) > 1:
                cost.check()
            out.append(confirmed(base, errors, hypothesis))
        except FAILURES as error:
            report(f"full-order run: {hypothesis.label}: {error}")
    if numerics.exact is not None:
        ranked = judged(base, errors, out)  # those that may still become the best
        near = {id(h.motion) for h in ranked if h.evidence > ranked[0].evidence - DECISION.hopeless}
        near.add(id(plain.motion))
        out = [corrected(h) if id(h.motion) in near else h for h in out]
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
        return None if further is None else corrected(further)

    out = fitted_while_it_helps(out, settled, better, lambda fits: judged(base, errors, fits))
    return out if len(out) > 1 else [*out, *chosen[:1]]


def fitted_while_it_helps(
    fits: Sequence[Hypothesis],
    settled: set[int],
    better: Callable[[Hypothesis], Hypothesis | None],
    ranked: Callable[[Sequence[Hypothesis]], list[Hypothesis]],
) -> list[Hypothesis]:
    """Sweeps over fits, best first and in turn; each is refined while the gain is sufficient.

    Args:
        fits: initial fits.
        settled: ids of the motions of fits that stay unchanged.
        better: returns a fit with a higher likelihood of the fitted frames; None without one.
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
