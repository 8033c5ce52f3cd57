"""Fits of effects to the fitted frames, together with the base model's values."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.baseline import Baseline, derivatives_of_residuals
from physconvex.gap.base.model import EffectModel
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.errors.screening import Screened
from physconvex.gap.options import GapOptions
from physconvex.gap.search.evidence import mean_square, negative_log_likelihood, residuals_per_one
from physconvex.gap.search.hypothesis import Hypothesis, deviations_of, hypothesis_at
from physconvex.gap.thresholds import SEARCH
from physconvex.identify import Fit, FitOptions, fit


def fit_effects(
    base: Baseline, errors: ErrorModel, chosen: Sequence[Screened], options: GapOptions, *,
    starts: Baseline | None = None,
) -> Hypothesis:  # fmt: skip
    """Fit base parameters and doses together, to the fitted frames.

    The first derivatives are the signatures of the screened effects. `starts` is the fit at which they are screened, if
    not the base fit; its effects are kept.

    Raises:
        ConvergenceError: the body cannot be simulated at the start.
    """
    point = base if starts is None else starts
    model = replace(point.model, effects=(*point.model.effects, *(entry.effect for entry in chosen)))
    values = _best_start(base, errors, model, _starts(base, errors, point, chosen, options))
    count = base.split.end
    tangents = np.concatenate([point.tangents[:count], *(_tangents(entry) for entry in chosen)], axis=1)
    return refit(base, errors, model, values, tangents, options=options)


def derivatives_at(base: Baseline, model: EffectModel, values: np.ndarray, motion: PointMotion) -> np.ndarray:
    """Derivatives of a model's predictions by all its values, in the frames up to the last fitted one.

    `motion` is the model's motion at the values, in all frames.

    Raises:
        ConvergenceError: the body cannot be simulated near there.
    """
    return replace(model, frames=base.split.end).linearise(values, motion.first(base.split.end))[1]


def _beside(base: Baseline, errors: ErrorModel, point: Baseline, chosen: Sequence[Screened]) -> np.ndarray:
    """The other values at the screened doses of the effects: the part that screening projects away, to first order.

    An inclusion three times as stiff needs another E of the whole; with the old one the search returns to none.
    """
    count, rows = base.split.end, base.rows(base.split.fitted)
    here = point.positions[:count]
    explained = sum(np.tensordot(entry.score.amounts, entry.signature[:, :count], 1) for entry in chosen)
    columns = derivatives_of_residuals(base, here, point.tangents[:count])[:, rows]
    left = (base.residual(point.positions) - base.change(here + explained))[rows]
    whitened = errors.restricted(rows)
    found = np.linalg.lstsq(whitened.whiten(columns).T, whitened.whiten(left), rcond=1e-8)[0]
    parameters = point.model.parameters(point.fit.values)
    steps = np.array([p.step for p in parameters])
    values = point.fit.values + np.clip(found, -SEARCH.far * steps, SEARCH.far * steps)
    return np.clip(values, [p.lower for p in parameters], [p.upper for p in parameters])


def _starts(
    base: Baseline, errors: ErrorModel, point: Baseline, chosen: Sequence[Screened], options: GapOptions
) -> list[np.ndarray]:  # fmt: skip
    """Start values: the screened doses and shares of them, with the other values unchanged or adapted.

    Screening is linear. For a strong effect its doses may be twice too large, and the motion is then so far from the
    recording's that a search returns to none.
    """
    null = np.concatenate([entry.effect.null for entry in chosen])
    shapes = np.array([dose.shape or dose.threshold for entry in chosen for dose in entry.effect.doses])
    doses = np.concatenate([_start(entry) for entry in chosen])
    values, beside = point.fit.values, _beside(base, errors, point, chosen)
    starts = [np.concatenate([values, doses])]
    for share in options.starts:
        lesser = np.where(shapes, doses, null + share * (doses - null))
        starts.append(np.concatenate([values + share * (beside - values), lesser]))
    return starts


def _best_start(base: Baseline, errors: ErrorModel, model: EffectModel, starts: Sequence[np.ndarray]) -> np.ndarray:
    """The values that fit the fitted frames best; values close to earlier ones are not tried."""
    steps = np.array([p.step for p in model.parameters(starts[0])])
    apart: list[np.ndarray] = []
    for values in starts:
        if all(np.abs((values - other) / steps).max() >= SEARCH.moved for other in apart):
            apart.append(values)
    if len(apart) == 1:
        return apart[0]
    shorter = replace(model, frames=base.split.end)
    return min(apart, key=lambda values: misfit_at(base, errors, shorter, values))


def misfit_at(base: Baseline, errors: ErrorModel, model: EffectModel, values: np.ndarray) -> float:
    """Misfit of a model's frames; infinite if it cannot be simulated."""
    try:
        return negative_log_likelihood(base, errors, model.positions(values))
    except (ConvergenceError, InputError):
        return np.inf


def refit(
    base: Baseline, errors: ErrorModel, model: EffectModel, values: np.ndarray, tangents: np.ndarray, *,
    options: GapOptions,
) -> Hypothesis:  # fmt: skip
    """Fit a model with effects from given values and derivatives.

    The weight of priors increases with the misfit (`EffectModel.doubt`), which may fall by a factor of a hundred in a
    fit. A held body, the only one with priors, is refitted with the weight and derivatives at the current values until
    both converge. Fibres and inclusions of other bodies are refitted too, while the likelihood of the fitted frames
    increases, since derivatives by their direction or place carry little information at a small dose.

    A held body may have two fixed points. With strong priors the residual is smooth, counts as few residuals, and keeps
    them strong; with weak ones it may be noise, which keeps them weak. The fit is therefore repeated with unscaled
    priors, and the likelier result counts. Otherwise the loads of held bars come out a quarter too light, since ν is
    not free, and a wrong frame rate is called instead.

    Raises:
        ConvergenceError: the body cannot be simulated at the start.
    """
    count = base.split.end
    shorter, own = replace(model, frames=count), len(base.fit.values)
    try:
        here = shorter.positions(values)
    except ConvergenceError:
        values = np.concatenate([values[:own], 0.5 * (values + model.null_values())[own:]])
        here = shorter.positions(values)
    tangents = tangents[:count].copy()
    _add_shapes(shorter, values, here, tangents)
    first = _settled(base, errors, shorter, _Point(values, here, tangents), _doubt(base, errors, here), options=options)
    best = _stated(base, errors, model, first)
    if not base.situation.clamped or _doubt(base, errors, first.here) < SEARCH.sure or base.model.cost.over:
        return best
    with suppress(ConvergenceError):
        other = _stated(base, errors, model, _settled(base, errors, shorter, first, 1.0, options=options))
        best = max(best, other, key=lambda h: h.evidence)
    return best


@dataclass(frozen=True, eq=False)
class _Point:
    """State of a fit: values, positions in the first frames, derivatives, and the fit that led there."""

    values: np.ndarray
    here: np.ndarray
    tangents: np.ndarray
    found: Fit | None = None


def _settled(
    base: Baseline, errors: ErrorModel, shorter: EffectModel, start: _Point, doubt: float, *, options: GapOptions
) -> _Point:  # fmt: skip
    """Refit from some values until values and prior weight converge, with a given weight in the first round."""
    weighted = base.weighted(errors.variance, base.split.end)
    stop = FitOptions(max_iterations=options.iterations + 1, relative_tolerance=2e-3, absolute_tolerance=0.1)
    point, left, settled, held = start, np.inf, False, base.situation.clamped
    placed = any(dose.shape for effect in shorter.effects for dose in effect.doses)
    rounds = SEARCH.rounds_held if held else SEARCH.rounds_placed if placed else 1
    for number in range(rounds):
        if number:
            before, doubt = doubt, _doubt(base, errors, point.here)
            if (settled and doubt > SEARCH.settled * before) or base.model.cost.over:
                break
        model = replace(shorter, doubt=doubt)
        tangents = model.linearise(point.values)[1] if number else point.tangents
        secant = model.secant(point.values, point.here, tangents)
        found = fit(secant, weighted, model.parameters(point.values), options=stop)
        point = _Point(found.values, found.positions, secant.tangents, found)
        misfit = found.reduced_chi_square if held else negative_log_likelihood(base, errors, point.here)
        settled, left = misfit > (SEARCH.still * left if held else left - SEARCH.slight), misfit
    return point


def _stated(base: Baseline, errors: ErrorModel, model: EffectModel, point: _Point) -> Hypothesis:
    """The model's predictions for all frames at the result of a fit."""
    assert point.found is not None
    motion = model.motion(point.values)
    deviations = deviations_of(base, errors, point.found, model.observed(motion, point.values))
    return hypothesis_at(base, errors, model, point.values, deviations, motion=motion, tangents=point.tangents)


def _doubt(base: Baseline, errors: ErrorModel, positions: np.ndarray) -> float:
    """Squared residual of the fitted frames over the expected one, times the residuals per independent one."""
    whole, fitted = np.concatenate([positions, base.positions[len(positions) :]]), base.split.fitted
    return max(mean_square(base, errors, whole, fitted), 1.0) * residuals_per_one(base, errors, whole, fitted)


def _start(entry: Screened) -> np.ndarray:
    """Screened doses, at least a fifth of the trial dose so that the effect is present."""
    null, doses = entry.effect.null, entry.doses.copy()
    for index, dose in enumerate(entry.effect.doses):
        if dose.shape or dose.threshold:
            continue
        trial = max(abs(t[index] - null[index]) for t in entry.trials)
        change = doses[index] - null[index]
        if dose.sign and abs(change) < SEARCH.least_dose * trial:
            change = SEARCH.least_dose * trial * dose.sign
        most = SEARCH.most_dose * trial
        doses[index] = np.clip(null[index] + np.clip(change, -most, most), dose.lower, dose.upper)
    return np.asarray(doses)


def _tangents(entry: Screened) -> np.ndarray:
    """Derivatives by all doses; those of shape doses start empty."""
    null = entry.effect.null
    out = np.zeros((entry.signature.shape[1], len(null), *entry.signature.shape[2:]))
    screened = [i for i, dose in enumerate(entry.effect.doses) if not dose.shape]
    for index, trial, signature in zip(screened, entry.trials, entry.signature, strict=True):
        out[:, index] = signature / entry.effect.doses[index].slope(float(trial[index]))
    return out


def _add_shapes(model: EffectModel, values: np.ndarray, here: np.ndarray, tangents: np.ndarray) -> None:
    """Derivatives by shape doses, which screening lacks, by finite differences."""
    for effect, where in zip(model.effects, model.slices, strict=True):
        for at, dose in enumerate(effect.doses, where.start):
            if dose.shape and not tangents[:, at].any():
                changed, step = values.copy(), 2 * dose.smallest
                if values[at] + step > dose.upper:
                    step = -step
                changed[at] += step
                tangents[:, at] = (model.positions(changed) - here) / step
