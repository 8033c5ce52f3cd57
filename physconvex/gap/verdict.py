"""From fits to a verdict: which effect, with what probability, and what it cannot be told apart from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from physconvex.gap.comparison import Hypothesis
from physconvex.gap.options import GapOptions
from physconvex.gap.screening import Screening

__all__ = ["NamedDose", "NamedEffect", "Verdict", "VerdictName", "decide", "probabilities"]

VerdictName = Literal["none", "effect", "unknown", "inconclusive"]
_CLEAR, _WEAK = 4.0, 1.5  # gain of log-evidence over the base model that makes a call, or leaves it open
_ALIKE = 0.95  # cosine of signatures
_LISTED = 0.02  # probability
_PLACEBO = 0.5  # share of an effect's shrinkage that a wrong effect may reach before the effect's counts for nothing
_BLIND = 0.1  # floor over size above which "none" would say nothing
_SURE = 30.0  # gain that makes a call although the base model fits the fitted frames within its error
_SEEN = 3.0  # standard errors
_ASTRAY = 0.5  # distance from the recording over its motion above which the model is no model of it
_FLOOR = 1.5  # a gap of less than this many times the expected square counts as none


@dataclass(frozen=True)
class NamedDose:
    """A fitted dose with its interval, in its unit."""

    name: str
    unit: str
    value: float
    lower: float
    upper: float
    null: float


@dataclass(frozen=True)
class NamedEffect:
    """One effect with its probability, doses, and the effects it may be confused with."""

    name: str
    variant: str
    source: str
    probability: float
    doses: tuple[NamedDose, ...]
    confused_with: tuple[str, ...]


@dataclass(frozen=True)
class Verdict:
    """The answer.

    Attributes:
        name: none, effect, unknown or inconclusive.
        sentence: for people.
        effects: the named effects and those that remain possible, most probable first.
        none_probability: of the base model.
        share: of the held-out gap above the floor that the best effect removes.
        caveats: what limits the answer.
    """

    name: VerdictName
    sentence: str
    effects: tuple[NamedEffect, ...]
    none_probability: float
    share: float
    caveats: tuple[str, ...]


def probabilities(hypotheses: Sequence[Hypothesis], temperature: float = 1.0) -> dict[str, float]:
    """Probability by label: softmax of the evidence, one hypothesis per set of names."""
    best: dict[tuple[str, ...], Hypothesis] = {}
    for hypothesis in hypotheses:
        names = tuple(sorted(hypothesis.names))
        if names not in best or hypothesis.evidence > best[names].evidence:
            best[names] = hypothesis
    kept = list(best.values())
    evidence = np.array([h.evidence for h in kept]) / temperature
    weights = np.exp(evidence - evidence.max())
    return {h.label: float(w) for h, w in zip(kept, weights / weights.sum(), strict=True)}


def _of_name(name: str, probability: dict[str, float]) -> float:
    """Probability that an effect is there: of all fits that have it."""
    return min(sum(p for label, p in probability.items() if name in _names(label)), 1.0)


def _names(label: str) -> list[str]:
    return [part.split(" (")[0] for part in label.split(" + ")]


def _by_weight(named: list[NamedEffect], hypotheses: Sequence[Hypothesis]) -> list[NamedEffect]:
    """Effects of one fit, the one first that explains most by itself."""
    alone = {h.names[0]: h.evidence for h in reversed(hypotheses) if len(h.effects) == 1}
    return sorted(named, key=lambda effect: -alone.get(effect.name, -np.inf))


def _named(
    hypothesis: Hypothesis, probability: dict[str, float], screening: Screening, options: GapOptions
) -> list[NamedEffect]:
    from scipy.stats import norm

    width = float(norm.ppf(0.5 + options.confidence / 2))
    by_label = {entry.effect.label: entry for entry in screening.ranked}
    out = []
    for effect in hypothesis.effects:
        values, errors = hypothesis.doses(effect)
        doses = tuple(
            NamedDose(
                d.name, d.unit, float(v), float(np.clip(v - width * e, d.lower, d.upper)),
                float(np.clip(v + width * e, d.lower, d.upper)), d.null,
            )
            for d, v, e in zip(effect.doses, values, errors, strict=True)
        )  # fmt: skip
        own = by_label[effect.label]
        alike = [
            e.effect.name
            for e in screening.one_per_name
            if e.effect.name != effect.name and screening.similarity(own, e) > _ALIKE
        ]
        rivals = [
            label.split(" (")[0]
            for label, p in probability.items()
            if p > 0.1 and label != hypothesis.label and label != "base model" and " + " not in label
        ]
        confused = tuple(dict.fromkeys(n for n in [*alike, *rivals] if n != effect.name))
        out.append(
            NamedEffect(effect.name, effect.variant, effect.source, _of_name(effect.name, probability), doses, confused)
        )
    return out


def decide(
    hypotheses: Sequence[Hypothesis],
    screening: Screening,
    before: float,
    after: float,
    remaining: float,
    options: GapOptions,
    *,
    floor: float = 0.0,
    placebo: float = float("nan"),
    astray: float = 0.0,
) -> Verdict:
    """The verdict.

    Args:
        hypotheses: the base model and fits, best evidence first.
        screening: for what is alike.
        before: mean square of the base model's residual over its expected square, all frames.
        after: the same with the best effects, held-out frames; one = nothing left above noise and numerical error.
        remaining: share of the held-out gap above the floor that the best effects leave, 0 to 1 and more.
        options: settings.
        floor: numerical error and noise over the size of the body; a model that errs by a tenth of it tells nothing.
        placebo: share of the held-out gap that an effect removes which screening ranked last; NaN where none was tried.
        astray: distance of the best model from the recording over how far that moves, rms.
    """
    base = next(h for h in hypotheses if not h.effects)
    with_effects = [h for h in hypotheses if h.effects]
    probability = probabilities(hypotheses)
    none = probability.get("base model", 0.0)
    if not with_effects:
        return Verdict("inconclusive", "No effect could be tried on this capture.", (), none, 0.0, ())
    best = with_effects[0]
    gain = best.evidence - base.evidence
    first = screening.ranked[0]
    tried = len(screening.ranked)
    significant = min(first.score.p_value * tried, 1.0) < options.significance
    named = _by_weight(_named(best, probability, screening, options), hypotheses)
    others = [
        effect
        for h in with_effects[1:]
        if len(h.effects) == 1 and h.names[0] not in best.names and probability.get(h.label, 0.0) > _LISTED
        for effect in _named(h, probability, screening, options)
    ]
    share = 1.0 - remaining
    closed = before < _FLOOR or (base.fitted < _FLOOR and gain < _SURE)
    none_found = gain < _WEAK or not significant or closed or _is_slight(best)
    if none_found and floor > _BLIND:
        sentence = (
            f"Inconclusive: the model's own numerical error and the noise ({floor:.0%} of the body's size) hide "
            "whatever gap there is. Allow a finer mesh, or record a motion with less contact."
        )
        return Verdict("inconclusive", sentence, (), none, share, (*_caveats(base, best, after), *_power(screening)))
    if none_found:
        reason = (
            "is smaller than is of interest"
            if _is_slight(best)
            else "lies within these errors"
            if closed
            else "is no more than chance"
        )
        sentence = f"No gap above noise and numerical error: what {best.label} would add {reason}."
        return Verdict("none", sentence, (), none, share, (*_caveats(base, best, after), *_power(screening)))
    if all(effect.source == "numerical" for effect in best.effects):
        sentence = (
            f"No physical cause: what the recording differs by is numerical error ({best.label}), of this model or of "
            "the program that made the recording."
        )
        return Verdict("none", sentence, (*named, *others), none, share, _caveats(base, best, after))
    if gain < _CLEAR:
        sentence = (
            f"Inconclusive: {best.label} is favoured, but the recording cannot tell it from no effect "
            f"(probability {probability[best.label]:.0%} against {none:.0%} for none)."
        )
        caveats = (*_caveats(base, best, after), *_power(screening))
        return Verdict("inconclusive", sentence, (*named, *others), none, share, caveats)
    if astray > _ASTRAY:
        sentence = (
            f"The model does not follow the recording: with {best.label} it is still off by {astray:.0%} of the motion. "
            "Check rest geometry, boundary, units, frame rate and gravity before looking for an effect."
        )
        return Verdict("unknown", sentence, (), none, share, _caveats(base, best, after))
    if share < options.explained and after > 2.0:
        sentence = (
            f"There is a gap that none of the known effects explains: the best of them, {best.label}, removes "
            f"{max(share, 0):.0%} of it on frames that were not fitted."
        )
        return Verdict("unknown", sentence, (*named, *others), none, share, _caveats(base, best, after))
    if placebo > _PLACEBO * share:
        sentence = (
            f"Inconclusive: {best.label} fits best and removes {share:.0%} of the gap on frames that were not fitted, "
            f"but an effect that the recording does not ask for removes {placebo:.0%} as well."
        )
        return Verdict("inconclusive", sentence, (*named, *others), none, share, _caveats(base, best, after))
    doses = "; ".join(f"{d.name} = {d.value:.3g} {d.unit}".strip() for e in named for d in e.doses)
    also = sorted({n for e in named for n in e.confused_with})
    caveat = f"; from this recording it may be confused with {', '.join(also)}" if also else ""
    chance = min(probability[best.label], 0.99)
    sure = f"probability {'above ' if probability[best.label] > 0.99 else ''}{chance:.0%}, not calibrated"
    sentence = f"The gap is caused by {best.label} ({sure}): {doses}{caveat}."
    return Verdict("effect", sentence, (*named, *others), none, share, _caveats(base, best, after))


def _is_slight(hypothesis: Hypothesis) -> bool:
    """Whether all doses lie nearer to null than is of interest: what fits so is the model's own error."""
    slight = []
    for effect in hypothesis.effects:
        values, _ = hypothesis.doses(effect)
        slight += [
            abs(v - d.null) < d.smallest
            for v, d in zip(values, effect.doses, strict=True)
            if not d.shape and effect.source != "numerical"
        ]
    return bool(slight) and all(slight)


def _power(screening: Screening) -> tuple[str, ...]:
    """Which doses would have been seen: three standard errors, of the effects with one dose that are seen best."""
    limits = []
    for entry in sorted(screening.one_per_name, key=lambda e: -e.power):
        screened = np.flatnonzero(entry.errors > 0)
        dose = entry.effect.doses[int(screened[0])] if len(screened) == 1 else None
        if dose is not None and not dose.threshold and entry.effect.source != "numerical":
            unit = f" {dose.unit}" if dose.unit else ""
            limits.append(f"{entry.effect.name} {_SEEN * float(entry.errors[screened[0]]):.2g}{unit}")
    return (f"Doses from which on an effect would have been seen here: {', '.join(limits[:6])}.",) if limits else ()


def _caveats(base: Hypothesis, best: Hypothesis, after: float) -> tuple[str, ...]:
    out = ["Density and E cannot be told apart from motion: E holds for the stated density."]
    moved = _moved(base, best)
    if moved is not None and abs(moved) > np.log10(1.15):
        out.append(
            f"E changed by {10**moved - 1:+.0%} when the effect was added: the plain model's E had absorbed part of it."
        )
    if any(effect.source == "numerical" for effect in best.effects):
        out.append(
            "The best explanation is a numerical error, of this model or of the program that made the recording."
        )
    if after > 4.0:
        out.append("What is left after the best effect is still well above noise and numerical error.")
    return tuple(out)


def _moved(base: Hypothesis, best: Hypothesis) -> float | None:
    names = base.model.base
    if "log10_youngs_modulus" not in names:
        return None
    index = names.index("log10_youngs_modulus")
    return float(best.values[index] - base.values[index])
