"""A fit of effects, how it compares with others on frames that no fit saw, and how fits are ranked."""

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
        vibration_likelihood: log-likelihood of how the recording rings, part of the evidence that is not tempered.
        later: the part of the likelihood that the frames make which choose, and which no fit saw.
        struck: kinds that are of frames from the first contact on; None where they are not divided.
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
        followed = seen >= -0.5 * self.information * np.log(SEARCH.followed + 1.0)
        gain = (-0.5 * self.information * np.log(2.0) - seen) / self.divisor
        return float(gain[~followed].sum())

    def foretells_more_than(self, other: Hypothesis) -> bool:
        """Whether the frames that choose are no less likely than with another fit, kinds weighed as in the evidence."""
        return bool(((self.later - other.later) / self.divisor).sum() >= 0)

    def tempered(self, divisor: Float[np.ndarray, " D"]) -> Hypothesis:
        """With the evidence that it has if only one in `divisor` residuals of each kind is independent."""
        told = self.information * self.moved
        evidence = evidence_of(
            self.likelihood, told, self.effects, self.values, divisor, struck=self.struck, deviations=self.errors
        )
        return replace(self, evidence=evidence + self.vibration_likelihood, divisor=divisor)


def hypothesis_at(
    base: Baseline, errors: ErrorModel, model: EffectModel, values: np.ndarray, deviations: np.ndarray,
    *, motion: PointMotion, tangents: np.ndarray,
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
    vibration_likelihood = damped_sine_likelihood(base, positions)
    struck = base.modes.struck
    told = information * moved
    evidence = (
        evidence_of(likelihood, told, model.effects, values, struck=struck, deviations=deviations)
        + vibration_likelihood
    )
    return Hypothesis(
        model.effects, model, values, deviations, positions, motion, tangents, fitted, selecting, evidence, likelihood,
        np.asarray(attainable), information, moved, vibration_likelihood=vibration_likelihood, later=later,
        struck=struck,
    )  # fmt: skip


def base_hypothesis(base: Baseline, errors: ErrorModel) -> Hypothesis:
    """The base model as one of those compared."""
    deviations = deviations_of(base, errors, base.fit, base.positions)
    return hypothesis_at(
        base, errors, base.model, base.fit.values, deviations, motion=base.motion, tangents=base.tangents
    )


def weighed_anew(base: Baseline, errors: ErrorModel, found: Hypothesis) -> Hypothesis:
    """A fit with other weights of the residuals than it was made or weighed with."""
    return hypothesis_at(
        base, errors, found.model, found.values, found.errors, motion=found.motion, tangents=found.tangents
    )


def continued(base: Baseline, found: Hypothesis) -> Baseline:
    """A baseline at a fit with effects: where the search for further effects goes on."""
    fit = replace(base.fit, parameters=found.model.parameters(found.values), values=found.values)
    return replace(base, model=found.model, fit=fit, motion=found.motion, tangents=found.tangents)


def deviations_of(base: Baseline, errors: ErrorModel, found: Fit, positions: np.ndarray) -> np.ndarray:
    """Standard errors of fitted values: what is left is no noise, and many residuals of it tell as much as a few."""
    alike = residuals_per_one(base, errors, positions, base.split.fitted)
    return marginal_deviations(found) * np.sqrt(max(found.reduced_chi_square * alike, 1.0))


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


def judged(base: Baseline, errors: ErrorModel, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """With the evidence of as many residuals as are independent in what the best of them leaves, best first.

    Fits with a dose at its bound are left out as long as others with effects are there.
    """
    hypotheses = within_bounds(hypotheses)
    best = max(hypotheses, key=lambda h: h.evidence)
    divisor = information_per_one(base, errors, best.positions)
    return sorted((h.tempered(divisor) for h in hypotheses), key=lambda h: -h.evidence)


def within_bounds(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Without fits that need a dose at the bound of what is physical, as long as others with effects are left."""
    kept = [h for h in hypotheses if not doses_at_bounds(h)]
    return kept if any(h.effects for h in kept) else list(hypotheses)


def finalists(
    found: Sequence[Hypothesis], count: int, *, tied: float = 0.0, forms: int = 1
) -> list[Hypothesis]:  # fmt: skip
    """The best fits with effects, one of each set of names; two single effects are among them.

    Args:
        found: fits.
        count: how many sets of names, at most two single effects not counted.
        tied: another form of the same effects is kept too where its evidence is less than this below the best one's.
        forms: so many of a single effect are kept whatever their evidence.

    A form whose doses came to nothing, fibres of no strength, says what the fit without it says: it stands for its
    effects only where all their forms came to that. And what fewer effects do as well comes after all that stands for
    itself: effects that seem to be none the better for a partner may yet be right where the model errs by ten.
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
    """Whether fewer of its effects say as much."""
    names = frozenset(combined.names)
    return any(part < names and same[0].evidence > combined.evidence for part, same in kept.items())


def evidence_of_anything(best: Hypothesis) -> float:
    """Of an unknown effect that leaves nothing but noise, at the price of as many doses as three effects have.

    It is the better explanation where even the best fit leaves much that does not look like noise.
    """
    price = 0.5 * EVIDENCE.anything * np.log(max(best.independent, 2.0))
    return float((best.attainable / best.divisor).sum() - price)
