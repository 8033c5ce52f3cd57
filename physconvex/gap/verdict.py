"""From fits to a verdict, by a list of rules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from physconvex.gap.caveats import caveats_of, doses_in_sight
from physconvex.gap.comparison import Hypothesis
from physconvex.gap.effects import Effect
from physconvex.gap.flight import IN_FLIGHT
from physconvex.gap.naming import (
    SOMETHING_ELSE,
    WEAK,
    NamedEffect,
    beside_something_else,
    by_weight,
    favoured,
    named_effects,
    probabilities,
)
from physconvex.gap.options import GapOptions
from physconvex.gap.screening import Screening

__all__ = ["Verdict", "VerdictName", "decide"]

VerdictName = Literal["none", "effect", "unknown", "inconclusive"]
_TRUSTED = 0.94  # share of calls that are right: 59 of 63 in the blind banks before, nearly all with 1.00 by evidence
_CLEAR = 4.0  # gain of log-evidence over the base model that makes a call; below `WEAK` it is open
_LISTED = 0.02  # probability
_FORETOLD = 0.9  # share of the gap on frames that were not fitted, of which a placebo removes no tenth
_PLACEBO = 0.5  # share of an effect's shrinkage that a wrong effect may reach before the effect's counts for nothing
_CERTAIN = 0.95  # probability, or share removed of _FORETOLD, from which on a placebo that does much is no objection
_LESS = 0.25  # and the share of what that placebo leaves which the effect may leave at most
_BLIND = 0.1  # floor over size or motion above which "none" would say nothing
_TELLING = 10.0  # gain that makes a call although the base model errs as expected, if half of the held-out gap goes
_ASTRAY = 0.5  # distance from the recording over its motion above which the model is no model of it
_LIKELY = 0.5  # probability from which on an effect is named
_DOUBT = 0.4  # probability of none and of something else above which no effect is
_ABUNDANT = 0.8  # of the share of the gap that must go, at twice the gain that is enough
_OPEN = 4.0  # times the expected square: a gap, whether or not an effect explains it
_SEEN = 1.5  # gap over the error expected on held-out frames from which on a body that is not struck has one
_WIDE = 4.0  # times the expected error of held-out frames, rms: a gap that no screening and no fit argues away
_FLOOR = 1.5  # a gap of less than this many times the expected square counts as none
_LATER = (
    "The flight before the first contact shows it beyond doubt. Of the held-out gap after it, it removes {:.0%}: the "
    "rest has another cause, of which a contact that works otherwise is the likeliest."
)


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
    above_error: float = float("-inf"),
    astray: float = 0.0,
    other: float = -np.inf,
    struck: bool = False,
    seen: float = np.inf,
    flight: float = -np.inf,
    forgiven: float = np.inf,
    reported: float = np.inf,
) -> Verdict:
    """The verdict: the first of a list of rules that holds.

    Args:
        hypotheses: the base model and fits, best evidence first.
        screening: for what is alike.
        before: mean square of the base model's residual over its expected square, all frames.
        after: the same with the best effects, held-out frames; one = nothing left above noise and numerical error.
        remaining: share of the held-out gap above noise that the best effects leave, 0 to 1 and more.
        options: settings.
        floor: numerical error and noise over the size of the body, or over its motion if that is less; a model that
            errs by a tenth of it tells nothing.
        placebo: share of the held-out gap that an effect removes which screening ranked last; NaN where none was tried.
        above_error: share that the best effects remove of the held-out gap above noise and numerical error; −inf where
            that is not known.
        astray: distance of the best model from the recording over how far that moves, rms.
        other: evidence of something that is not among the hypotheses.
        struck: whether a free body strikes something, after which models part for little.
        seen: gap of the base model on held-out frames over what noise and numerical error lead one to expect, rms.
        flight: what the best effects gain before the first contact, see `physconvex.gap.flight`.
        forgiven: `after`, if a rebound as a whole may be off by three times as much, see
            `physconvex.gap.rebound.forgiving`.
        reported: the share that the best effects remove in those held-out frames that did not choose them.
    """
    base = next(h for h in hypotheses if not h.effects)
    best = favoured(hypotheses)
    shown = probabilities(hypotheses, other)
    if best is None:
        none = beside_something_else(shown, 0.0).get("base model", 0.0)
        return Verdict("inconclusive", "No effect could be tried on this capture.", (), none, 0.0, ())
    flies = flight >= _TELLING and any(effect.source in IN_FLIGHT for effect in best.effects)
    probability = beside_something_else(shown, 1.0 if flies else 1.0 - remaining)
    evidence = _Evidence(
        base, best, tuple(hypotheses), screening, probability, before, after, 1.0 - remaining, options, floor, placebo,
        above_error, astray, struck, seen, flies, forgiven, reported,
    )  # fmt: skip
    rules = (_nothing, _slight, _numerical, _weak, _off_the_recording, _unexplained, _as_good_as_a_placebo)
    for rule in rules:
        verdict = rule(evidence)
        if verdict is not None:
            return verdict
    return _called(evidence)


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What the rules read; the numbers are the arguments of `decide`, `share` is what the best effects remove."""

    base: Hypothesis
    best: Hypothesis
    hypotheses: tuple[Hypothesis, ...]
    screening: Screening
    probability: dict[str, float]
    before: float
    after: float
    share: float
    options: GapOptions
    floor: float
    placebo: float
    above_error: float
    astray: float
    struck: bool
    seen: float
    flies: bool
    forgiven: float
    reported: float

    @property
    def in_flight_alone(self) -> bool:
        """Whether the effects show beyond doubt before the first contact, and explain little of what follows it."""
        return self.flies and self.share < self.options.explained

    @property
    def gain(self) -> float:
        """Of log-evidence."""
        return self.best.evidence - self.base.evidence

    @property
    def foretold(self) -> bool:
        """Whether held-out frames leave no doubt, although the evidence counts too few residuals as independent."""
        return self.gain >= WEAK and self.share >= _FORETOLD and self._beyond_placebo

    @property
    def clear(self) -> bool:
        """Whether fitted and held-out frames together make a call: the less sure the ones, the more the others do."""
        return self.gain >= _CLEAR or self._kept(_CLEAR)

    @property
    def telling(self) -> bool:
        """Whether the effect counts although the base model errs by no more than is expected of it.

        The error of a body that strikes nothing is well known: what lies within it on held-out frames too is no gap,
        however well some effect of many doses, an inclusion say, can follow it.
        """
        return self._kept(_TELLING) and (self.struck or self.seen >= _SEEN)

    def _kept(self, enough: float) -> bool:
        """Whether held-out frames make up for a gain below `enough`: the smaller it is, the more of the gap must go."""
        shares = (_FORETOLD, self.options.explained, _ABUNDANT * self.options.explained)
        asked = float(np.interp(self.gain, (WEAK, enough, 2 * enough), shares))
        return self.gain >= WEAK and self.share >= asked and self._beyond_placebo

    @property
    def _beyond_placebo(self) -> bool:
        """Whether a placebo does next to nothing, or much evidence is for an effect that leaves a quarter of it."""
        sure = self.gain >= _TELLING and self.share >= _FORETOLD
        return self.placebo < 1.0 - _FORETOLD or (sure and 1.0 - self.share <= _LESS * (1.0 - self.placebo))

    @property
    def open(self) -> bool:
        """Whether a gap is there, of the base model and on held-out frames with the best effects too."""
        return min(self.before, self.after) >= _OPEN

    @property
    def left_wide_open(self) -> bool:
        """Whether held-out frames have a gap far beyond what is expected, which the best effects leave."""
        return self.seen >= _WIDE and self.share < self.options.explained and np.isfinite(self.seen)

    @property
    def none(self) -> float:
        """Probability of the base model."""
        return self.probability.get("base model", 0.0)

    @property
    def named(self) -> tuple[NamedEffect, ...]:
        """Effects of the best fit, without those whose doses are smaller than is of interest beside others."""
        slight = {effect.name for effect in self.best.effects if _is_slight(self.best, effect)}
        found = named_effects(self.best, self.hypotheses, self.probability, self.screening, self.options)
        kept = [effect for effect in found if effect.name not in slight] or found
        if self.in_flight_alone:
            kept = [effect for effect in kept if effect.source in IN_FLIGHT] or kept
        return tuple(by_weight(kept, self.hypotheses))

    @property
    def possible(self) -> tuple[NamedEffect, ...]:
        """Those of the best fit, and the single ones that remain possible."""
        others = [
            effect
            for h in self.hypotheses
            if len(h.effects) == 1
            and h is not self.best
            and h.names[0] not in self.best.names
            and self.probability.get(h.label, 0.0) > _LISTED
            for effect in named_effects(h, self.hypotheses, self.probability, self.screening, self.options)
        ]
        return (*self.named, *others)

    @property
    def further(self) -> tuple[NamedEffect, ...]:
        """Effects that the best fit gains too little by to have them, and that are possible all the same.

        Not those which gain much in the fitted frames and lose in later ones.
        """
        found: dict[str, NamedEffect] = {}
        for h in self.hypotheses:
            if set(h.names) > set(self.best.names) and h.foretells_more_than(self.best):
                for effect in named_effects(h, self.hypotheses, self.probability, self.screening, self.options):
                    if effect.name not in self.best.names and effect.probability > _LISTED:
                        found.setdefault(effect.name, effect)
        return tuple(found.values())

    def verdict(
        self, name: VerdictName, sentence: str, effects: tuple[NamedEffect, ...] = (), *, power: bool = False
    ) -> Verdict:
        """With the caveats, and with what would have been seen; probabilities as calls have turned out to be right."""
        effects = tuple(replace(effect, probability=_TRUSTED * effect.probability) for effect in effects)
        caveats = caveats_of(self.base, self.best, self.after)
        if name == "effect" and self.in_flight_alone:
            caveats = (_LATER.format(max(self.share, 0.0)), *caveats)
        more = doses_in_sight(self.screening) if power else ()
        return Verdict(name, sentence, effects, self.none, self.share, (*caveats, *more))


def _nothing(e: _Evidence) -> Verdict | None:
    """No gap above noise and numerical error; where those are large, that says nothing."""
    significant = min(e.screening.ranked[0].score.p_value * len(e.screening.ranked), 1.0) < e.options.significance
    # a fit finds what one finite dose does not
    significant = significant or (e.gain >= _TELLING and e.telling) or (e.foretold and e.seen >= _SEEN)
    closed = min(e.before, e.base.fitted) < _FLOOR and not e.telling
    little = e.gain < WEAK and e.before < _OPEN
    slight = _is_slight(e.best) and not e.open and not e.foretold
    late = e.telling and e.before >= _OPEN  # a gap that opens after the fitted frames, and that the effect foretells
    if not (little or slight or (not late and (closed or not significant))):
        return None
    if e.floor > _BLIND:
        return _blind(e)
    if (e.open and not _is_slight(e.best)) or e.left_wide_open:
        sentence = (
            "Inconclusive: a gap opens after the frames that were fitted, above noise and numerical error, and "
            f"{e.best.label}, which fits best, does not foretell it."
        )
        return e.verdict("inconclusive", sentence, power=True)
    reason = "is no more than chance"
    if closed:
        reason = "lies within these errors"
    if _is_slight(e.best):
        reason = "is smaller than is of interest"
    sentence = f"No gap above noise and numerical error: what {e.best.label} would add {reason}."
    return e.verdict("none", sentence, power=True)


def _slight(e: _Evidence) -> Verdict | None:
    """A dose too small to be of interest fits best, and leaves the gap."""
    if not _is_slight(e.best) or e.foretold:
        return None
    if e.floor > _BLIND:
        return _blind(e)
    sentence = (
        f"Inconclusive: there is a gap above noise and numerical error, but what fits it best, {e.best.label}, is "
        "smaller than is of interest and leaves it."
    )
    return e.verdict("inconclusive", sentence, power=True)


def _blind(e: _Evidence) -> Verdict:
    sentence = (
        f"Inconclusive: the model's own numerical error and the noise ({e.floor:.0%} of the body's size or "
        "motion) hide whatever gap there is. Allow a finer mesh, or record a motion with less contact."
    )
    return e.verdict("inconclusive", sentence, power=True)


def _numerical(e: _Evidence) -> Verdict | None:
    """All effects of the best fit are numerical; where such errors are large, that says nothing either."""
    if any(effect.source != "numerical" for effect in e.best.effects):
        return None
    if e.floor > _BLIND:
        return _blind(e)
    if e.open:
        sentence = (
            f"Inconclusive: numerical error ({e.best.label}) fits best, but leaves a gap above noise and what "
            "else this model errs by."
        )
        return e.verdict("inconclusive", sentence, e.possible)
    sentence = (
        f"No physical cause: what the recording differs by is numerical error ({e.best.label}), of this model or of "
        "the program that made the recording."
    )
    return e.verdict("none", sentence, e.possible)


def _weak(e: _Evidence) -> Verdict | None:
    """A gain too small for a call."""
    if e.clear:
        return None
    sentence = (
        f"Inconclusive: {e.best.label} is favoured, but the recording cannot tell it from no effect that is known "
        f"(probability {e.probability[e.best.label]:.0%} against {e.none:.0%} for none)."
    )
    return e.verdict("inconclusive", sentence, e.possible, power=True)


def _off_the_recording(e: _Evidence) -> Verdict | None:
    """The model is none of this recording."""
    if e.astray <= _ASTRAY:
        return None
    sentence = (
        f"The model does not follow the recording: with {e.best.label} it is still off by {e.astray:.0%} of the "
        "motion. Check rest geometry, boundary, units, frame rate and gravity before looking for an effect."
    )
    return e.verdict("unknown", sentence)


def _unexplained(e: _Evidence) -> Verdict | None:
    """A gap that the best effects leave; what the model's own error may be is not for effects to explain."""
    if max(e.share, e.above_error) >= e.options.explained or e.after <= 2.0 or e.flies:
        return None
    if e.struck and (e.best.fitted < _FLOOR or e.forgiven <= 2.0):
        sentence = (
            f"Inconclusive: with {e.best.label} the model fits as well as it can err, and later parts from the "
            "recording: an unknown effect would do so, and so would a rebound that is a little off."
        )
        return e.verdict("inconclusive", sentence, e.possible)
    sentence = (
        f"There is a gap that none of the known effects explains: the best of them, {e.best.label}, removes "
        f"{max(e.share, 0):.0%} of it on frames that were not fitted."
    )
    return e.verdict("unknown", sentence, e.possible)


def _as_good_as_a_placebo(e: _Evidence) -> Verdict | None:
    """An effect that nothing asks for does nearly as much, or the best one does nothing where it was not fitted."""
    certain = bool(e.named) and min(n.probability for n in e.named) >= _CERTAIN
    if e.flies or ((certain or e.share >= _FORETOLD) and 1.0 - e.share <= _LESS * (1.0 - e.placebo)):
        return None
    nothing = e.share <= 0 or (e.reported <= 0 and e.after > 2.0)
    if not (nothing or e.placebo > _PLACEBO * e.share):
        return None
    if nothing:
        sentence = (
            f"Inconclusive: {e.best.label} fits best, but removes nothing of the gap on frames that were not fitted."
        )
        return e.verdict("inconclusive", sentence, e.possible)
    sentence = (
        f"Inconclusive: {e.best.label} fits best and removes {e.share:.0%} of the gap on frames that were not fitted, "
        f"but an effect that the recording does not ask for removes {e.placebo:.0%} as well."
    )
    return e.verdict("inconclusive", sentence, e.possible)


def _called(e: _Evidence) -> Verdict:
    """The best effects are the cause."""
    likely = tuple(n for n in e.named if n.probability >= _LIKELY) or (
        max(e.named, key=lambda n: n.probability),
    )  # of several that are alike none may have half, and it is one of them all the same
    if e.probability.get(SOMETHING_ELSE, 0.0) + e.none >= _DOUBT and not (e.foretold or e.flies):
        shares = ", ".join(f"{n.name} {n.probability:.0%}" for n in e.possible)
        sentence = (
            f"Inconclusive: there is a gap, and {e.best.label} fits best, but leaves so much that "
            f"it may well be none of them ({shares}; something else {e.probability.get(SOMETHING_ELSE, 0.0):.0%})."
        )
        return e.verdict("inconclusive", sentence, e.possible)
    doses = "; ".join(f"{d.name} = {d.value:.3g} {d.unit}".strip() for n in likely for d in n.doses)
    also = sorted({name for n in likely for name in n.confused_with})
    caveat = f"; from this recording it may be confused with {', '.join(also)}" if also else ""
    perhaps = [f"{n.name} ({_TRUSTED * n.probability:.0%})" for n in (*e.named, *e.further) if n not in likely]
    added = f"; perhaps also by {', '.join(perhaps)}" if perhaps else ""
    label = " + ".join(x.label for x in e.best.effects if x.name in {n.name for n in likely})
    sure = ", ".join(f"{_TRUSTED * n.probability:.0%}" for n in likely)
    sentence = f"The gap is caused by {label} (probability {sure}): {doses}{added}{caveat}."
    return e.verdict("effect", sentence, e.possible)


def _is_slight(hypothesis: Hypothesis, *effects: Effect) -> bool:
    """Whether all doses (of all effects unless some are given) lie nearer to null than is of interest.

    What fits so is the model's own error.
    """
    slight = []
    for effect in effects or hypothesis.effects:
        values, _ = hypothesis.doses(effect)
        slight += [
            abs(v - d.null) < d.smallest
            for v, d in zip(values, effect.doses, strict=True)
            if not d.shape and effect.source != "numerical"
        ]
    return bool(slight) and all(slight)
