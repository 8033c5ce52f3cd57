"""Fits of the few effects that screening ranks first, and how they compare on frames that no fit saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError
from physconvex.gap.baseline import Baseline, Report
from physconvex.gap.effects import Effect
from physconvex.gap.model import EffectModel, SecantModel
from physconvex.gap.observing import widened
from physconvex.gap.options import GapOptions
from physconvex.gap.score import ErrorModel
from physconvex.gap.screening import Screened, Screening
from physconvex.identify import Fit, FitOptions, fit, noise_covariance

_LEFT = 2.0  # excess above which a second effect is looked for

__all__ = ["Hypothesis", "base_hypothesis", "compare"]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """The base model, or it with effects, fitted.

    Attributes:
        effects: none for the base model.
        model: the model, all frames.
        values: base parameters, then doses.
        errors: standard errors, lack of fit included.
        positions: what it says is observed [m], all frames.
        fitted: mean square of the residuals in the fitted frames, in units of the error model's variance.
        selecting: the same in the frames that choose.
        excess: mean square of the residuals in the fitted frames, over that of noise and numerical error.
        evidence: log-evidence up to a constant.
    """

    effects: tuple[Effect, ...]
    model: EffectModel
    values: Float[np.ndarray, " K"]
    errors: Float[np.ndarray, " K"]
    positions: Float[np.ndarray, "T P 3"]
    fitted: float
    selecting: float
    excess: float
    evidence: float

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


def _mean_square(base: Baseline, errors: ErrorModel, positions: np.ndarray, frames: np.ndarray) -> float:
    rows = base.rows(frames)
    if not len(rows):
        return float("nan")
    return float(np.mean(base.residual(positions)[rows] ** 2 / errors.variance[rows]))


def _information(base: Baseline, errors: ErrorModel, frames: np.ndarray) -> float:
    """Number of independent residuals: each counts by the share of its variance that is noise, smooth errors by 12."""
    rows = base.rows(frames)
    if not len(rows):
        return 0.0
    frame = base.observations.frames[rows]
    noise = np.bincount(frame, 1 / errors.variance[rows], minlength=base.model.frames)
    return float(np.minimum(noise + 3.0, np.bincount(frame, minlength=base.model.frames))[np.unique(frame)].sum())


def _evidence(base: Baseline, errors: ErrorModel, fitted: float, selecting: float, extra: int) -> float:
    """−n/2 ln(mean square) with unknown scale, floored where the error model is met, less ½ k ln n for doses.

    The mean square is that of noise and numerical error together; below one it says nothing more.
    """
    split = base.split
    total = 0.0
    for value, frames in ((fitted, split.fitted), (selecting, split.selecting)):
        if np.isfinite(value):
            total -= 0.5 * _information(base, errors, frames) * np.log(value + 0.02)
    return float(total - 0.5 * extra * np.log(max(_information(base, errors, split.fitted), 2.0)))


def _hypothesis(
    base: Baseline, errors: ErrorModel, model: EffectModel, values: np.ndarray, deviations: np.ndarray,
    positions: np.ndarray,
) -> Hypothesis:  # fmt: skip
    fitted = _mean_square(base, errors, positions, base.split.fitted)
    selecting = _mean_square(base, errors, positions, base.split.selecting)
    extra = sum(len(e.doses) for e in model.effects)
    evidence = _evidence(base, errors, fitted, selecting, extra)
    rows = base.rows(base.split.fitted)
    excess = float(np.mean(base.residual(positions)[rows] ** 2 / errors.expected[rows]))
    return Hypothesis(model.effects, model, values, deviations, positions, fitted, selecting, excess, evidence)


def base_hypothesis(base: Baseline, errors: ErrorModel) -> Hypothesis:
    """The base model as one of those compared."""
    deviations = np.sqrt(np.diag(noise_covariance(base.fit)))
    return _hypothesis(base, errors, base.model, base.fit.values, deviations, base.positions)


def fit_effects(
    base: Baseline,
    errors: ErrorModel,
    chosen: Sequence[Screened],
    options: GapOptions,
    *,
    multiple: float = 1.0,
    start: Hypothesis | None = None,
) -> Hypothesis:
    """Fit base parameters and doses together, to the fitted frames.

    Args:
        base: base fit.
        errors: weights of the residuals.
        chosen: the effects, as screened: their signatures are the first derivatives.
        options: settings.
        multiple: of the screened doses, to start from.
        start: a fitted hypothesis with some of the effects, to start from.

    Raises:
        ConvergenceError: the body cannot be simulated at the start.
    """
    effects = tuple(entry.effect for entry in chosen)
    model = replace(base.model, effects=effects)
    values = np.concatenate([base.fit.values, *(_start(entry, multiple) for entry in chosen)])
    if start is not None:
        values[: len(base.fit.values)] = start.values[: len(base.fit.values)]
        for effect in start.effects:
            values[model.slices[effects.index(effect)]] = start.doses(effect)[0]
    count = int(base.split.fitted[-1]) + 1
    shorter = replace(model, frames=count)
    tangents = np.concatenate([base.tangents, *(_tangents(entry) for entry in chosen)], axis=1)[:count]
    weighted = widened(base.observations, errors.variance).in_frames(count)
    try:
        here = shorter.positions(values)
    except ConvergenceError:
        values[len(base.fit.values) :] = 0.5 * (values + model.null_values())[len(base.fit.values) :]
        here = shorter.positions(values)
    _add_shapes(shorter, values, here, tangents)
    secant = SecantModel(shorter, values, here, tangents)
    stop = FitOptions(max_iterations=options.iterations + 1, relative_tolerance=2e-3, absolute_tolerance=0.1)
    found = fit(secant, weighted, shorter.parameters(values), options=stop)
    return _finished(base, errors, model, found)


def _finished(base: Baseline, errors: ErrorModel, model: EffectModel, found: Fit) -> Hypothesis:
    spread = max(found.reduced_chi_square, 1.0)
    deviations = np.sqrt(np.diag(noise_covariance(found)) * spread)
    return _hypothesis(base, errors, model, found.values, deviations, model.positions(found.values))


def _start(entry: Screened, multiple: float) -> np.ndarray:
    """Screened doses, at least a fifth of the trial dose so that the effect is there at all."""
    null, doses = entry.effect.null, entry.doses.copy()
    for index, dose in enumerate(entry.effect.doses):
        if dose.shape or dose.threshold:
            continue
        trial = max(abs(t[index] - null[index]) for t in entry.trials)
        change = multiple * (doses[index] - null[index])
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
            if dose.shape:
                changed = values.copy()
                at, step = where.start + index, 2 * dose.smallest
                if values[at] + step > dose.upper:
                    step = -step
                changed[at] += step
                tangents[:, at] = (model.positions(changed) - here) / step


def compare(
    base: Baseline, errors: ErrorModel, screening: Screening, options: GapOptions, report: Report
) -> list[Hypothesis]:
    """The base model and fits of the best effects (and of the best two together), by evidence, best first."""
    found = [base_hypothesis(base, errors)]
    by_label = {entry.effect.label: entry for entry in screening.ranked}
    for entry in _candidates(screening, options):
        for multiple in options.starts:
            report(f"fit: {entry.effect.label}")
            try:
                found.append(fit_effects(base, errors, [entry], options, multiple=multiple))
            except ConvergenceError:
                report(f"fit: {entry.effect.label} failed")
    found.sort(key=lambda h: -h.evidence)
    best = found[0]
    if best.effects and best.excess > _LEFT:  # something is left: is it a second effect?
        others = [h for h in found[1:] if h.effects and h.names[0] != best.names[0]]
        for other in others[:2]:
            pair = [by_label[best.effects[0].label], by_label[other.effects[0].label]]
            report(f"fit: {best.label} and {other.label}")
            try:
                found.append(fit_effects(base, errors, pair, options, start=best))
            except ConvergenceError:
                report("fit: the pair failed")
    return sorted(found, key=lambda h: -h.evidence)


def _candidates(screening: Screening, options: GapOptions) -> list[Screened]:
    """The best effects by name."""
    return list(screening.one_per_name[: options.candidates])
