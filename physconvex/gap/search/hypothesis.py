"""A fit of effects, its comparison with others on held-out frames, and the ranking of fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.base.model import EffectModel
from physconvex.gap.effects.effect import Effect
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.search.damped_sine import damped_sine_likelihood
from physconvex.gap.search.evidence import (
    evidence_of,
    information_by_kind,
    information_per_one,
    likelihood_by_kind,
    mean_square,
    moved_kinds,
    residuals_per_one,
    squares_by_kind,
)
from physconvex.gap.thresholds import EVIDENCE, SEARCH
from physconvex.identify import Fit, marginal_deviations


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """The base model, alone or with effects, fitted.

    Attributes:
        effects: empty for the base model.
        model: the model, all frames.
        values: base parameters, then doses.
        errors: standard errors, lack of fit included.
        positions: predicted observed positions [m], all frames.
        motion: motion of the points, before observation.
        tangents: derivatives of the positions by the values, in the first frames, shape [f, K, P, 3].
        fitted: mean square of the residuals in the fitted frames, over that of noise and numerical error.
        selecting: the same in the selecting frames, for the kind with the largest value.
        evidence: log-evidence up to a constant, tempered or not.
        likelihood: its part from the residuals, not tempered, by kind (`physconvex.gap.base.body_modes`).
        attainable: the likelihood of residuals with noise and numerical error alone.
        information: number of independent fitted residuals by kind.
        moved: kinds that its effects change; only these residuals inform the doses.
        divisor: residuals per independent one, by kind; it tempers the evidence.
        vibration_likelihood: log-likelihood of the recorded vibration, a part of the evidence that is not tempered.
        later: part of the likelihood from the selecting frames, which no fit uses.
        struck: kinds of frames from the first contact on; None if they are not divided.
    """

    effects: tuple[Effect, ...]
    model: EffectModel
    values: Float[np.ndarray, " K"]
    errors: Float[np.ndarray, " K"]
    positions: Float[np.ndarray, "T P 3"]
    motion: PointMotion
    tangents: Float[np.ndarray, "f K P 3"]
    fitted: float
    selecting: float
    evidence: float
    likelihood: Float[np.ndarray, " D"] = field(default_factory=lambda: np.zeros(1))
    attainable: Float[np.ndarray, " D"] = field(default_factory=lambda: np.zeros(1))
    information: Float[np.ndarray, " D"] = field(default_factory=lambda: np.full(1, 2.0))
    moved: Bool[np.ndarray, " D"] = field(default_factory=lambda: np.ones(1, dtype=bool))
    divisor: Float[np.ndarray, " D"] = field(default_factory=lambda: np.ones(1))
    vibration_likelihood: float = 0.0
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
        """Whether all doses (of all effects unless some are given) are closer to null than is of interest.

        Such a fit describes the model's own error.
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
        """Number of independent fitted residuals."""
        return float((self.information / self.divisor).sum())

    @property
    def seen(self) -> float:
        """Log-likelihood of the fitted frames, up to a constant.

        For a struck body the mean square hardly separates fits: most residuals belong to the flight, which all follow.
        """
        return float((self.likelihood - self.later).sum())

    @property
    def left_to_explain(self) -> float:
        """Possible gain of log-likelihood in the fitted frames, down to noise and numerical error.

        It is computed by kind, since the error of a rebound hides a small residual of the flight in the mean. Kinds
        within their errors add nothing.
        """
        seen = self.likelihood - self.later
        followed = seen >= -0.5 * self.information * np.log(SEARCH.followed + 1.0)
        gain = (-0.5 * self.information * np.log(2.0) - seen) / self.divisor
        return float(gain[~followed].sum())

    def foretells_more_than(self, other: Hypothesis) -> bool:
        """Whether the selecting frames are at least as likely as with another fit, weighted as in the evidence."""
        return bool(((self.later - other.later) / self.divisor).sum() >= 0)

    def tempered(self, divisor: Float[np.ndarray, " D"]) -> Hypothesis:
        """The fit with its evidence if only one in `divisor` residuals of each kind is independent."""
        told = self.information * self.moved
        evidence = evidence_of(
            self.likelihood, told, self.effects, self.values, divisor, struck=self.struck, deviations=self.errors
        )
        return replace(self, evidence=evidence + self.vibration_likelihood, divisor=divisor)


def hypothesis_at(
    base: Baseline, errors: ErrorModel, model: EffectModel, values: np.ndarray, deviations: np.ndarray,
    *, motion: PointMotion, tangents: np.ndarray,
) -> Hypothesis:  # fmt: skip
    """A model at fitted values, with its predictions and their misfit."""
    positions, parts = model.observed(motion, values), (base.split.fitted, base.split.selecting)
    seen, later = (likelihood_by_kind(base, errors, positions, frames) for frames in parts)
    found = Hypothesis(
        model.effects, model, values, deviations, positions, motion, tangents,
        fitted=mean_square(base, errors, positions, base.split.fitted),
        selecting=float(np.nanmax(squares_by_kind(base, errors, positions, base.split.selecting), initial=0.0)),
        evidence=0.0,
        likelihood=seen + later,
        attainable=np.asarray(sum(likelihood_by_kind(base, errors, None, frames) for frames in parts)),
        information=information_by_kind(base, errors, base.split.fitted),
        moved=moved_kinds(base, errors, positions),
        vibration_likelihood=damped_sine_likelihood(base, positions),
        later=later,
        struck=base.modes.struck,
    )  # fmt: skip
    return found.tempered(np.ones(base.modes.count))


def base_hypothesis(base: Baseline, errors: ErrorModel) -> Hypothesis:
    """The base model as a hypothesis."""
    deviations = deviations_of(base, errors, base.fit, base.positions)
    return hypothesis_at(
        base, errors, base.model, base.fit.values, deviations, motion=base.motion, tangents=base.tangents
    )


def weighed_anew(base: Baseline, errors: ErrorModel, found: Hypothesis) -> Hypothesis:
    """A fit with other weights of the residuals."""
    return hypothesis_at(
        base, errors, found.model, found.values, found.errors, motion=found.motion, tangents=found.tangents
    )


def continued(base: Baseline, found: Hypothesis) -> Baseline:
    """A baseline at a fit with effects, from which the search for further effects continues."""
    fit = replace(base.fit, parameters=found.model.parameters(found.values), values=found.values)
    return replace(base, model=found.model, fit=fit, motion=found.motion, tangents=found.tangents)


def deviations_of(base: Baseline, errors: ErrorModel, found: Fit, positions: np.ndarray) -> np.ndarray:
    """Standard errors of fitted values: the residual is no noise, and many residuals carry as little as a few."""
    alike = residuals_per_one(base, errors, positions, base.split.fitted)
    return marginal_deviations(found) * np.sqrt(max(found.reduced_chi_square * alike, 1.0))


def doses_at_bounds(best: Hypothesis) -> list[str]:
    """Doses that the fit drives to a bound other than their null value.

    Shape doses may lie there: an inclusion at the very face of a body is valid.
    """
    found = []
    for effect in best.effects:
        for dose, value in zip(effect.doses, best.doses(effect)[0], strict=True):
            near, bounds = 1e-3 * (dose.upper - dose.lower), (dose.lower, dose.upper)
            bound = any(abs(value - bound) < near and abs(bound - dose.null) > near for bound in bounds)
            if bound and not dose.shape:
                found.append(f"{effect.name} ({dose.name} = {value:.3g} {dose.unit})".replace(" )", ")"))
    return found


def judged(base: Baseline, errors: ErrorModel, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Fits with the evidence of the independent residuals in the best one's residual, best first.

    Fits with a dose at its bound are excluded while others with effects remain.
    """
    hypotheses = within_bounds(hypotheses)
    best = max(hypotheses, key=lambda h: h.evidence)
    divisor = information_per_one(base, errors, best.positions)
    return sorted((h.tempered(divisor) for h in hypotheses), key=lambda h: -h.evidence)


def within_bounds(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Exclude fits with a dose at the bound of what is physical, while others with effects remain."""
    kept = [h for h in hypotheses if not doses_at_bounds(h)]
    return kept if any(h.effects for h in kept) else list(hypotheses)


def finalists(found: Sequence[Hypothesis], count: int, *, tied: float = 0.0, forms: int = 1) -> list[Hypothesis]:
    """The best fits with effects, one of each set of names; two single effects are among them.

    Args:
        found: fits.
        count: maximum number of sets of names, up to two single effects not counted.
        tied: another form of the same effects is kept if its evidence is within this of the best one's.
        forms: number of forms of a single effect that are kept whatever their evidence.

    A form with zero doses, such as fibres of no strength, equals the fit without it. It represents its effects only if
    all their forms have zero doses. A fit that fewer effects match ranks after all others, but is kept: such effects
    may be right if the model's error is about ten in evidence.
    """
    kept: dict[frozenset[str], list[Hypothesis]] = {}
    for hypothesis in sorted((h for h in found if h.effects), key=lambda h: (h.is_slight(), -h.evidence)):
        same = kept.setdefault(frozenset(hypothesis.names), [])
        if not same or _another(hypothesis, same, tied, forms):
            same.append(hypothesis)
    ranked = sorted(kept.values(), key=lambda same: (_idle(same[0], kept), -same[0].evidence))
    singles = [same for same in ranked if len(same[0].effects) == 1][: min(2, count)]
    chosen = [*ranked[:count], *(same for same in singles if same not in ranked[:count])]
    return [h for same in chosen for h in same]


def _another(hypothesis: Hypothesis, same: Sequence[Hypothesis], tied: float, forms: int) -> bool:
    """Whether a fit is another form of the same effects that is worth keeping."""
    labels = {e.label for e in hypothesis.effects}
    if any(labels == {e.label for e in other.effects} for other in same):
        return False
    if hypothesis.is_slight() != same[0].is_slight():
        return False
    return hypothesis.evidence > same[0].evidence - tied or (len(labels) == 1 and len(same) < forms)


def _idle(combined: Hypothesis, kept: dict[frozenset[str], list[Hypothesis]]) -> bool:
    """Whether fewer of its effects fit as well."""
    names = frozenset(combined.names)
    return any(part < names and same[0].evidence > combined.evidence for part, same in kept.items())


def evidence_of_anything(best: Hypothesis) -> float:
    """Evidence of an unknown effect that leaves only noise, at the price of three effects' doses.

    It is the better explanation if even the best fit leaves much more than noise.
    """
    price = 0.5 * EVIDENCE.anything * np.log(max(best.independent, 2.0))
    return float((best.attainable / best.divisor).sum() - price)
