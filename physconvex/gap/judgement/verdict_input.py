"""Input of the rules in `physconvex.gap.judgement.verdict`: fits, held-out measures, and derived quantities."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from physconvex.gap.effects.effect import IN_FLIGHT
from physconvex.gap.errors.screening import Screening
from physconvex.gap.judgement.caveats import caveats_of, doses_in_sight
from physconvex.gap.judgement.naming import NamedEffect, Verdict, VerdictName, by_weight, named_effects
from physconvex.gap.judgement.residual_measures import Measured
from physconvex.gap.options import GapOptions
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.thresholds import VERDICT

_LATER = (
    "The flight before the first contact shows it beyond doubt. Of the held-out gap after it, it removes {:.0%}: the "
    "rest has another cause, of which a contact that works otherwise is the likeliest."
)


@dataclass(frozen=True, eq=False)
class VerdictInput:
    """Input of the rules.

    Attributes:
        base, best: the base model, and the reported fit with effects.
        hypotheses: all fits, best evidence first.
        screening: gives similar effects.
        probability: by label.
        measured: measures of both.
        options: settings.
        flies: whether effects that need no contact show clearly before the first one.
    """

    base: Hypothesis
    best: Hypothesis
    hypotheses: tuple[Hypothesis, ...]
    screening: Screening
    probability: dict[str, float]
    measured: Measured
    options: GapOptions
    flies: bool

    @property
    def in_flight_alone(self) -> bool:
        """Whether the effects show clearly before the first contact, and explain little of the later frames."""
        return self.flies and self.measured.share < self.options.explained

    @property
    def gain(self) -> float:
        """Gain of log-evidence."""
        return self.best.evidence - self.base.evidence

    @property
    def foretold(self) -> bool:
        """Whether held-out frames decide, although the evidence counts too few residuals as independent."""
        return self.gain >= VERDICT.weak and self.measured.share >= VERDICT.foretold and self._beyond_placebo

    @property
    def clear(self) -> bool:
        """Whether fitted and held-out frames together make a call: each can make up for the other."""
        return self.gain >= VERDICT.clear or self._kept(VERDICT.clear)

    @property
    def telling(self) -> bool:
        """Whether the effect counts although the base model's error is within its expected size.

        The error of a body without impact is well known. A residual within it on held-out frames too is no gap, even if
        an effect of many doses, such as an inclusion, can follow it.
        """
        return self._kept(VERDICT.telling) and (self.measured.struck or self.measured.seen >= VERDICT.seen)

    def _kept(self, enough: float) -> bool:
        """Whether held-out frames make up for a gain below `enough`; a smaller gain needs a larger share of the gap."""
        shares = (VERDICT.foretold, self.options.explained, VERDICT.abundant * self.options.explained)
        asked = float(np.interp(self.gain, (VERDICT.weak, enough, 2 * enough), shares))
        return self.gain >= VERDICT.weak and self.measured.share >= asked and self._beyond_placebo

    @property
    def _beyond_placebo(self) -> bool:
        """Whether a placebo does next to nothing, or leaves four times as much and there is strong evidence.

        For a struck body ten times as much suffices: held ones have one or two vibrations, which many effects follow.
        """
        m, little = self.measured, 1.0 - VERDICT.foretold
        less = VERDICT.placebo_left if self.gain >= VERDICT.telling else little if m.struck else 0.0
        return m.placebo < little or 1.0 - m.share <= less * (1.0 - m.placebo)

    @property
    def open(self) -> bool:
        """Whether there is a gap of the base model, and on held-out frames with the best effects too."""
        return min(self.measured.before, self.measured.after) >= VERDICT.open

    @property
    def left_wide_open(self) -> bool:
        """Whether held-out frames have a gap far above the expected one, which the best effects leave."""
        m = self.measured
        return m.seen >= VERDICT.wide and m.share < self.options.explained and bool(np.isfinite(m.seen))

    @property
    def flight_is_open(self) -> bool:
        """Whether each known effect was tried and leaves a gap before the first contact."""
        return self.measured.flight_left >= VERDICT.open and not self.measured.hurried

    @property
    def none(self) -> float:
        """Probability of the base model."""
        return self.probability.get("base model", 0.0)

    def _effects_of(self, fit: Hypothesis) -> list[NamedEffect]:
        return named_effects(fit, self.hypotheses, self.probability, self.screening, self.options)

    @property
    def named(self) -> tuple[NamedEffect, ...]:
        """Effects of the best fit, without those with doses below the smallest of interest."""
        slight = {effect.name for effect in self.best.effects if self.best.is_slight(effect)}
        found = self._effects_of(self.best)
        kept = [effect for effect in found if effect.name not in slight] or found
        if self.in_flight_alone:
            kept = [effect for effect in kept if effect.source in IN_FLIGHT] or kept
        return tuple(by_weight(kept, self.hypotheses))

    @property
    def possible(self) -> tuple[NamedEffect, ...]:
        """Effects of the best fit, and single ones that remain possible."""
        others = [
            effect
            for h in self.hypotheses
            if len(h.effects) == 1
            and h is not self.best
            and h.names[0] not in self.best.names
            and self.probability.get(h.label, 0.0) > VERDICT.listed
            for effect in self._effects_of(h)
        ]
        return (*self.named, *others)

    @property
    def further(self) -> tuple[NamedEffect, ...]:
        """Effects that remain possible although the best fit gains too little by them.

        Effects with a large gain in the fitted frames and a loss in later ones are excluded.
        """
        found: dict[str, NamedEffect] = {}
        for h in self.hypotheses:
            if set(h.names) > set(self.best.names) and h.foretells_more_than(self.best):
                for effect in self._effects_of(h):
                    if effect.name not in self.best.names and effect.probability > VERDICT.listed:
                        found.setdefault(effect.name, effect)
        return tuple(found.values())

    def verdict(
        self, name: VerdictName, sentence: str, effects: tuple[NamedEffect, ...] = (), *, power: bool = False
    ) -> Verdict:
        """The verdict with caveats and detectable doses; probabilities are calibrated by the accuracy of calls."""
        effects = tuple(replace(effect, probability=VERDICT.trusted * effect.probability) for effect in effects)
        caveats = caveats_of(self.base, self.best, self.measured.after)
        if name == "effect" and self.in_flight_alone:
            caveats = (_LATER.format(max(self.measured.share, 0.0)), *caveats)
        more = doses_in_sight(self.screening) if power else ()
        return Verdict(name, sentence, effects, self.none, self.measured.share, (*caveats, *more))
