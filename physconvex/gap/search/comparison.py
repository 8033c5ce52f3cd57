"""Fits of effects, and how they compare on frames that no fit saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from physconvex.errors import ConvergenceError
from physconvex.gap.base.baseline import Baseline, derivatives_of_residuals
from physconvex.gap.base.model import EffectModel, SecantModel
from physconvex.gap.effects import Effect, Motion
from physconvex.gap.errors.score import ErrorModel
from physconvex.gap.errors.screening import Screened
from physconvex.gap.options import GapOptions
from physconvex.gap.search.evidence import (
    evidence_of,
    information_by_kind,
    likelihood_by_kind,
    mean_square,
    misfit_of,
    moved_kinds,
    residuals_per_one,
    squares_by_kind,
)
from physconvex.gap.search.ringing import ringing_likelihood
from physconvex.identify import Fit, FitOptions, fit, marginal_deviations

__all__ = [
    "Hypothesis",
    "base_hypothesis",
    "continued",
    "derivatives_at",
    "doses_at_bounds",
    "fit_effects",
    "hypothesis_at",
    "refit",
]

_FOLLOWED = 1.5  # mean square over the expected one up to which nothing is left of a kind of residuals
_ROUNDS, _PLACED = 6, 3  # of the fit of a held body, and of what lies somewhere in another, or along something
_STILL, _SETTLED = 0.98, 0.7  # shares of misfit and doubt above which another one is not worth it
_SLIGHT = 0.5  # gain of log-likelihood below which it is not of a body that is not held
_FAR, _MOVED = 5.0, 0.3  # typical steps: most that other values are moved by, and from which on it is tried


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """The base model, or it with effects, fitted.

    Attributes:
        effects: none for the base model.
        model: the model, all frames.
        values: base parameters, then doses.
        errors: standard errors, lack of fit included.
        positions: what it says is observed [m], all frames.
        motion: of the points, before observation.
        tangents: derivatives of the positions by the values, in the first frames, shape [f, K, P, 3].
        fitted: mean square of the residuals in the fitted frames, over that of noise and numerical error.
        selecting: the same in the frames that choose, of the kind that has most.
        evidence: log-evidence up to a constant, tempered or not.
        likelihood: its part that the residuals make, not tempered, by kind (`physconvex.gap.base.body_modes`).
        attainable: what that would be if nothing but noise and numerical error were left.
        information: number of independent fitted residuals by kind.
        moved: kinds that its effects change something of: only of these the residuals tell the doses.
        divisor: residuals per independent one that the evidence is tempered with, by kind.
        ringing: log-likelihood of how the recording rings, part of the evidence that is not tempered.
        later: the part of the likelihood that the frames make which choose, and which no fit saw.
        struck: kinds that are of frames from the first contact on; None where they are not divided.
    """

    effects: tuple[Effect, ...]
    model: EffectModel
    values: Float[np.ndarray, " K"]
    errors: Float[np.ndarray, " K"]
    positions: Float[np.ndarray, "T P 3"]
    motion: Motion
    tangents: Float[np.ndarray, "f K P 3"]
    fitted: float
    selecting: float
    evidence: float
    likelihood: Float[np.ndarray, " D"] = field(default_factory=lambda: np.zeros(1))
    attainable: Float[np.ndarray, " D"] = field(default_factory=lambda: np.zeros(1))
    information: Float[np.ndarray, " D"] = field(default_factory=lambda: np.full(1, 2.0))
    moved: Bool[np.ndarray, " D"] = field(default_factory=lambda: np.ones(1, dtype=bool))
    divisor: Float[np.ndarray, " D"] = field(default_factory=lambda: np.ones(1))
    ringing: float = 0.0
    later: Float[np.ndarray, " D"] = field(default_factory=lambda: np.zeros(1))
    struck: Bool[np.ndarray, " D"] | None = None

    @property
    def label(self) -> str:
        """Names of its effects."""
        return " + ".join(e.label for e in self.effects) or "base model"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its effects without variants."""
        return tuple(e.name for e in self.effects)

    def doses(self, effect: Effect) -> tuple[Float[np.ndarray, " D"], Float[np.ndarray, " D"]]:
        """Doses of an effect and their standard errors."""
        where = self.model.slices[self.effects.index(effect)]
        return self.values[where], self.errors[where]

    def is_slight(self, *effects: Effect) -> bool:
        """Whether all doses (of all effects unless some are given) lie nearer to null than is of interest.

        What fits so is the model's own error.
        """
        slight = [
            abs(value - dose.null) < dose.smallest
            for effect in effects or self.effects
            for value, dose in zip(self.doses(effect)[0], effect.doses, strict=True)
            if not dose.shape and effect.source != "numerical"
        ]
        return bool(slight) and all(slight)

    @property
    def independent(self) -> float:
        """Number of independent fitted residuals, those that are alike counted once."""
        return float((self.information / self.divisor).sum())

    @property
    def seen(self) -> float:
        """Log-likelihood of the fitted frames, up to a constant.

        Of a struck body the mean square hardly tells one fit from a better one: most of its residuals are of the
        flight, which all of them follow.
        """
        return float((self.likelihood - self.later).sum())

    @property
    def left_to_explain(self) -> float:
        """Gain of log-likelihood in the fitted frames by whatever would leave nothing but noise and numerical error.

        Kind by kind: what little is left of a flight hides in the mean beside what a rebound errs by. Kinds that lie
        within their errors leave nothing.
        """
        seen = self.likelihood - self.later
        followed = seen >= -0.5 * self.information * np.log(_FOLLOWED + 1.0)
        gain = (-0.5 * self.information * np.log(2.0) - seen) / self.divisor
        return float(gain[~followed].sum())

    def foretells_more_than(self, other: Hypothesis) -> bool:
        """Whether the frames that choose are no less likely than with another fit, kinds weighed as in the evidence."""
        return bool(((self.later - other.later) / self.divisor).sum() >= 0)

    def tempered(self, divisor: Float[np.ndarray, " D"]) -> Hypothesis:
        """With the evidence that it has if only one in `divisor` residuals of each kind is independent."""
        told = self.information * self.moved
        evidence = evidence_of(self.likelihood, told, self.effects, self.values, divisor, struck=self.struck)
        return replace(self, evidence=evidence + self.ringing, divisor=divisor)


def hypothesis_at(
    base: Baseline, errors: ErrorModel, model: EffectModel, values: np.ndarray, deviations: np.ndarray,
    motion: Motion, tangents: np.ndarray,
) -> Hypothesis:  # fmt: skip
    """A model at fitted values, with what it says and how well that fits."""
    positions = model.observed(motion, values)
    fitted = mean_square(base, errors, positions, base.split.fitted)
    selecting = float(np.nanmax(squares_by_kind(base, errors, positions, base.split.selecting), initial=0.0))
    seen, later = (likelihood_by_kind(base, errors, positions, f) for f in (base.split.fitted, base.split.selecting))
    attainable = sum(likelihood_by_kind(base, errors, None, f) for f in (base.split.fitted, base.split.selecting))
    likelihood = seen + later
    information = information_by_kind(base, errors, base.split.fitted)
    moved = moved_kinds(base, errors, positions)
    ringing = ringing_likelihood(base, positions)
    struck = base.modes.struck
    evidence = evidence_of(likelihood, information * moved, model.effects, values, struck=struck) + ringing
    return Hypothesis(
        model.effects, model, values, deviations, positions, motion, tangents, fitted, selecting, evidence, likelihood,
        np.asarray(attainable), information, moved, ringing=ringing, later=later, struck=struck,
    )  # fmt: skip


def base_hypothesis(base: Baseline, errors: ErrorModel) -> Hypothesis:
    """The base model as one of those compared."""
    deviations = _deviations(base, errors, base.fit, base.positions)
    return hypothesis_at(base, errors, base.model, base.fit.values, deviations, base.motion, base.tangents)


def continued(base: Baseline, found: Hypothesis) -> Baseline:
    """A baseline at a fit with effects: where the search for further effects goes on."""
    fit = replace(base.fit, parameters=found.model.parameters(found.values), values=found.values)
    return replace(base, model=found.model, fit=fit, motion=found.motion, tangents=found.tangents)


def fit_effects(
    base: Baseline,
    errors: ErrorModel,
    chosen: Sequence[Screened],
    options: GapOptions,
    *,
    starts: Baseline | None = None,
) -> Hypothesis:
    """Fit base parameters and doses together, to the fitted frames.

    Args:
        base: base fit.
        errors: weights of the residuals.
        chosen: the effects, as screened: their signatures are the first derivatives.
        options: settings.
        starts: where the effects were screened, if elsewhere than at the base fit; effects it has are kept.

    Raises:
        ConvergenceError: the body cannot be simulated at the start.
    """
    point = base if starts is None else starts
    model = replace(point.model, effects=(*point.model.effects, *(entry.effect for entry in chosen)))
    values = _best_start(base, errors, model, _starts(base, errors, point, chosen, options))
    count = base.split.end
    tangents = np.concatenate([point.tangents[:count], *(_tangents(entry) for entry in chosen)], axis=1)
    return refit(base, errors, model, values, tangents, options)


def derivatives_at(base: Baseline, model: EffectModel, values: np.ndarray, motion: Motion) -> np.ndarray:
    """Derivatives of what a model says by all its values, in the frames up to the last fitted one.

    Args:
        base: for the frames.
        model: the model, all frames.
        values: where.
        motion: the model's there.

    Raises:
        ConvergenceError: the body cannot be simulated near there.
    """
    return replace(model, frames=base.split.end).tangents(values, motion.first(base.split.end))


def _beside(base: Baseline, errors: ErrorModel, point: Baseline, chosen: Sequence[Screened]) -> np.ndarray:
    """Where the other values go if the effects have their screened doses: what screening projects away, to first order.

    An inclusion that is three times as stiff asks for another E of the whole; with the old one the search ran back to
    none.
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
    values = point.fit.values + np.clip(found, -_FAR * steps, _FAR * steps)
    return np.clip(values, [p.lower for p in parameters], [p.upper for p in parameters])


def _starts(
    base: Baseline, errors: ErrorModel, point: Baseline, chosen: Sequence[Screened], options: GapOptions
) -> list[np.ndarray]:  # fmt: skip
    """Values to begin at: the screened doses and shares of them, with the other values as they are or beside.

    Screening is linear. Of a strong effect its doses may be twice what they should, and the motion then so far from the
    recording's that a search goes back to none.
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
    """The values that fit the fitted frames best; those that hardly differ from ones before are not tried."""
    steps = np.array([p.step for p in model.parameters(starts[0])])
    apart: list[np.ndarray] = []
    for values in starts:
        if all(np.abs((values - other) / steps).max() >= _MOVED for other in apart):
            apart.append(values)
    if len(apart) == 1:
        return apart[0]
    count = base.split.end
    shorter = replace(model, frames=count)

    def misfit(values: np.ndarray) -> float:
        try:
            return misfit_of(base, errors, shorter.positions(values))
        except ConvergenceError:
            return float("inf")

    return min(apart, key=misfit)


def refit(
    base: Baseline,
    errors: ErrorModel,
    model: EffectModel,
    values: np.ndarray,
    tangents: np.ndarray,
    options: GapOptions,
) -> Hypothesis:
    """Fit a model with effects from given values and derivatives.

    Priors weigh the more the worse the fit (`EffectModel.doubt`), which may begin a hundred times as bad as it ends. A
    held body, the only one that has priors, is fitted anew by what is left, with derivatives taken where it is, until
    both stay. So are fibres and inclusions of another body, while that makes the fitted frames likelier: derivatives
    by their direction or place, taken where there is hardly any dose of them, say next to nothing.

    Raises:
        ConvergenceError: the body cannot be simulated at the start.
    """
    count = base.split.end
    shorter, own = replace(model, frames=count), len(base.fit.values)
    weighted = base.weighted(errors.variance, count)
    try:
        here = shorter.positions(values)
    except ConvergenceError:
        values = np.concatenate([values[:own], 0.5 * (values + model.null_values())[own:]])
        here = shorter.positions(values)
    tangents = tangents[:count].copy()
    _add_shapes(shorter, values, here, tangents)
    stop = FitOptions(max_iterations=options.iterations + 1, relative_tolerance=2e-3, absolute_tolerance=0.1)
    doubt, left, settled, held = np.inf, np.inf, False, base.situation.clamped
    placed = any(dose.shape for effect in model.effects for dose in effect.doses)
    rounds = _ROUNDS if held else _PLACED if placed else 1
    for number in range(rounds):
        before, doubt = doubt, _doubt(base, errors, here)
        if number and ((settled and doubt > _SETTLED * before) or base.model.cost.over):
            break
        shorter = replace(shorter, doubt=doubt)
        if number:
            tangents = shorter.tangents(values, shorter.motion(values))
        secant = SecantModel(shorter, values, here, tangents)
        found = fit(secant, weighted, shorter.parameters(values), options=stop)
        values, here, tangents = found.values, found.positions, secant.tangents
        misfit = found.reduced_chi_square if held else misfit_of(base, errors, here)
        settled, left = misfit > (_STILL * left if held else left - _SLIGHT), misfit
    motion = model.motion(found.values)
    deviations = _deviations(base, errors, found, model.observed(motion, found.values))
    return hypothesis_at(base, errors, model, found.values, deviations, motion, tangents)


def _deviations(base: Baseline, errors: ErrorModel, found: Fit, positions: np.ndarray) -> np.ndarray:
    """Standard errors of fitted values: what is left is no noise, and many residuals of it tell as much as a few."""
    alike = residuals_per_one(base, errors, positions, base.split.fitted)
    return marginal_deviations(found) * np.sqrt(max(found.reduced_chi_square * alike, 1.0))


def _doubt(base: Baseline, errors: ErrorModel, positions: np.ndarray) -> float:
    """Square of what the fitted frames leave over what is expected, times the residuals that count for one."""
    whole, fitted = np.concatenate([positions, base.positions[len(positions) :]]), base.split.fitted
    return max(mean_square(base, errors, whole, fitted), 1.0) * residuals_per_one(base, errors, whole, fitted)


def _start(entry: Screened) -> np.ndarray:
    """Screened doses, at least a fifth of the trial dose so that the effect is there at all."""
    null, doses = entry.effect.null, entry.doses.copy()
    for index, dose in enumerate(entry.effect.doses):
        if dose.shape or dose.threshold:
            continue
        trial = max(abs(t[index] - null[index]) for t in entry.trials)
        change = doses[index] - null[index]
        if dose.sign and abs(change) < 0.2 * trial:
            change = 0.2 * trial * dose.sign
        doses[index] = np.clip(null[index] + np.clip(change, -8 * trial, 8 * trial), dose.lower, dose.upper)
    return np.asarray(doses)


def _tangents(entry: Screened) -> np.ndarray:
    """Derivatives by all doses; those that only shape the effect start without one."""
    null = entry.effect.null
    out = np.zeros((entry.signature.shape[1], len(null), *entry.signature.shape[2:]))
    screened = [i for i, dose in enumerate(entry.effect.doses) if not dose.shape]
    for index, trial, signature in zip(screened, entry.trials, entry.signature, strict=True):
        out[:, index] = signature / entry.effect.doses[index].slope(float(trial[index]))
    return out


def _add_shapes(model: EffectModel, values: np.ndarray, here: np.ndarray, tangents: np.ndarray) -> None:
    """Derivatives by the doses that only shape an effect, which screening does not have, by differences."""
    for effect, where in zip(model.effects, model.slices, strict=True):
        for index, dose in enumerate(effect.doses):
            if dose.shape and not tangents[:, where.start + index].any():
                changed = values.copy()
                at, step = where.start + index, 2 * dose.smallest
                if values[at] + step > dose.upper:
                    step = -step
                changed[at] += step
                tangents[:, at] = (model.positions(changed) - here) / step


def doses_at_bounds(best: Hypothesis) -> list[str]:
    """Doses that the fit drove to a bound other than their null value.

    Those that only shape an effect may lie there: an inclusion at the very face of a body is none less.
    """
    found = []
    for effect in best.effects:
        for dose, value in zip(effect.doses, best.doses(effect)[0], strict=True):
            if dose.shape:
                continue
            near = 1e-3 * (dose.upper - dose.lower)
            if any(abs(value - bound) < near and abs(bound - dose.null) > near for bound in (dose.lower, dose.upper)):
                found.append(f"{effect.name} ({dose.name} = {value:.3g} {dose.unit})".replace(" )", ")"))
    return found
