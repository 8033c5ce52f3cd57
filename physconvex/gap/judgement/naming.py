"""Effects by name: probability, doses, intervals, and the effects that look alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import norm

from physconvex.gap.effects.effect import Dose, Effect
from physconvex.gap.errors.screening import Screening
from physconvex.gap.options import GapOptions
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.thresholds import VERDICT

SOMETHING_ELSE = "something else"
_DEFORMING = ("material", "contact")  # sources whose effects act through deformation or contact
VerdictName = Literal["none", "effect", "unknown", "inconclusive"]


@dataclass(frozen=True)
class NamedDose:
    """A fitted dose with its interval, in its unit."""

    name: str
    unit: str
    value: float
    lower: float
    upper: float
    null: float

    @classmethod
    def within(cls, dose: Dose, value: float, width: float) -> NamedDose:
        """A value with an interval of a half width, both sides cut at the bounds of the dose."""
        lower, upper = np.clip([value - width, value + width], dose.lower, dose.upper)
        return cls(dose.name, dose.unit, float(value), float(lower), float(upper), dose.null)


@dataclass(frozen=True)
class NamedEffect:
    """One effect with its probability, doses, and the effects it may be confused with."""

    name: str
    variant: str
    source: str
    probability: float
    doses: tuple[NamedDose, ...]
    confused_with: tuple[str, ...]


def favoured(hypotheses: Sequence[Hypothesis]) -> Hypothesis | None:
    """The reported fit with effects: the best, or one with fewer effects if the others gain too little.

    Effects that gain in the fitted frames and lose in the held-out ones count as gaining too little. Damping or an
    uneven E beside the true cause otherwise follows the differences between programs after an impact. In a recording
    whose floor gives way by percents of the body's size, effects must gain more, since they also follow the energy
    exchange of such a contact. There, effects that act through deformation or contact always count as too little: for
    MuJoCo's cube with friction, flow gains 11 although it is absent.

    Args:
        hypotheses: best evidence first.
    """
    best = next((h for h in hypotheses if h.effects), None)
    if best is None:
        return None
    soft = best.model.situation.in_soft_floor
    little = VERDICT.soft_floor if soft else VERDICT.weak

    def may_be_the_floor(h: Hypothesis) -> bool:
        return soft and all(e.source in _DEFORMING for e in best.effects if e.name not in h.names)

    enough = [
        h
        for h in hypotheses
        if h.effects and set(h.names) < set(best.names)
        and (best.evidence - h.evidence < little or not best.foretells_more_than(h) or may_be_the_floor(h))
    ]  # fmt: skip
    return min(enough, key=lambda h: (len(h.effects), -h.evidence), default=best)


def probabilities(hypotheses: Sequence[Hypothesis], other: float = -np.inf) -> dict[str, float]:
    """Probability by label: softmax of the evidence, one hypothesis per set of names.

    `other` is the evidence of an effect outside the hypotheses.
    """
    best: dict[frozenset[str], Hypothesis] = {}
    for hypothesis in hypotheses:
        same = best.setdefault(frozenset(hypothesis.names), hypothesis)
        if hypothesis.evidence > same.evidence:
            best[frozenset(hypothesis.names)] = hypothesis
    kept = list(best.values())
    evidence = np.array([*(h.evidence for h in kept), other])
    weights = np.exp(evidence - evidence.max())
    labels = [*(h.label for h in kept), SOMETHING_ELSE]
    return {label: float(w) for label, w in zip(labels, weights / weights.sum(), strict=True) if w > 0}


def beside_something_else(probability: dict[str, float], share: float) -> dict[str, float]:
    """Probability of another effect, limited to the gap that the best effects leave."""
    other = probability.get(SOMETHING_ELSE, 0.0)
    left = other * float(np.clip(1.0 - share, 0.0, 1.0))
    known = {label: p for label, p in probability.items() if label != SOMETHING_ELSE}
    total = max(sum(known.values()), 1e-300)
    return {
        **{label: p / total * (1.0 - left) for label, p in known.items()},
        **({SOMETHING_ELSE: left} if left > 0 else {}),
    }


def _of_name(name: str, probability: dict[str, float]) -> float:
    """Probability that an effect is present: sum over all fits with it."""
    return min(sum(p for label, p in probability.items() if name in _names(label)), 1.0)


def _names(label: str) -> list[str]:
    return [part.split(" (")[0] for part in label.split(" + ")]


def _alike(one: Effect, other: Effect) -> float:
    """Cosine of two signatures above which the effects count as indistinguishable."""
    declared = other.name in one.confusable or one.name in other.confusable
    return VERDICT.alike_as_declared if declared else VERDICT.alike


def by_weight(found: list[NamedEffect], hypotheses: Sequence[Hypothesis]) -> list[NamedEffect]:
    """Effects of one fit, in the order of what each explains by itself."""
    alone = {h.names[0]: h.evidence for h in reversed(hypotheses) if len(h.effects) == 1}
    return sorted(found, key=lambda effect: -alone.get(effect.name, -np.inf))


def _errors(
    effect: Effect, chosen: Hypothesis, hypotheses: Sequence[Hypothesis], probability: dict[str, float]
) -> np.ndarray:
    """Standard errors of an effect's doses, with the spread over other fits that have it, by their probability."""
    others = [h for h in hypotheses if effect in h.effects]
    weights = np.array([probability.get(h.label, 0.0) for h in others])
    own, errors = chosen.doses(effect)
    squares = errors**2
    if weights.sum() > 0:
        squares = weights @ np.array([e**2 + (v - own) ** 2 for v, e in (h.doses(effect) for h in others)])
        squares /= weights.sum()
    return np.asarray(np.sqrt(squares + _form_errors(effect, own, held=chosen.model.situation.clamped) ** 2))


def _form_errors(effect: Effect, doses: np.ndarray, *, held: bool) -> np.ndarray:
    """A share of the dose: of the vector length for doses in one unit, as a change of the logarithm for decades.

    It is the least error. For a nearly perfect fit, the residuals give 1 %, below the error by mesh, steps and contact.
    """
    share = VERDICT.form_deforming if held or effect.source in _DEFORMING else VERDICT.form
    out = np.empty(len(doses))
    for i, dose in enumerate(effect.doses):
        alike = [j for j, other in enumerate(effect.doses) if other.unit == dose.unit]
        size = np.linalg.norm(doses[alike] - np.array([effect.doses[j].null for j in alike]))
        out[i] = share * (1 / np.log(10) if dose.unit.startswith("log10") else size)
    return out


def named_effects(
    hypothesis: Hypothesis, hypotheses: Sequence[Hypothesis], probability: dict[str, float], screening: Screening,
    options: GapOptions,
) -> list[NamedEffect]:  # fmt: skip
    """Effects of a fit, with the doses of all fits that have them, and the similar effects of the screening."""
    width = float(norm.ppf(0.5 + options.confidence / 2))
    by_label = {entry.effect.label: entry for entry in screening.ranked}
    known = ("base model", SOMETHING_ELSE, hypothesis.label)
    single = [n for n, p in probability.items() if p > VERDICT.rival and n not in known and " + " not in n]
    rivals = [label.split(" (")[0] for label in single]
    out = []
    for effect in hypothesis.effects:
        values, errors = hypothesis.doses(effect)[0], _errors(effect, hypothesis, hypotheses, probability)
        doses = tuple(map(NamedDose.within, effect.doses, values, width * errors))
        own = by_label[effect.label]
        alike = [
            e.effect.name
            for e in screening.one_per_name
            if e.effect.name != effect.name and screening.similarity(own, e) > _alike(effect, e.effect)
        ]
        confused = tuple(dict.fromkeys(n for n in [*alike, *rivals] if n != effect.name))
        likely = _of_name(effect.name, probability)
        out.append(NamedEffect(effect.name, effect.variant, effect.source, likely, doses, confused))
    return out


@dataclass(frozen=True)
class Verdict:
    """The verdict.

    Attributes:
        name: none, effect, unknown or inconclusive.
        sentence: for people.
        effects: the named effects and those that remain possible, most probable first.
        none_probability: probability of the base model.
        share: share of the held-out gap above the floor that the best effect removes.
        caveats: limits of the verdict.
    """

    name: VerdictName
    sentence: str
    effects: tuple[NamedEffect, ...]
    none_probability: float
    share: float
    caveats: tuple[str, ...]
