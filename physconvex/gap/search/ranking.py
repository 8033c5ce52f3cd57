"""Fits of effects ranked: by evidence, without what no body can bear, and beside something that is in no dictionary."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.errors.score import ErrorModel
from physconvex.gap.search.comparison import Hypothesis, doses_at_bounds
from physconvex.gap.search.evidence import information_per_one

__all__ = ["evidence_of_anything", "finalists", "judged", "within_bounds"]

_ANYTHING = 8  # doses and effects that an unknown effect is priced at


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


def finalists(found: Sequence[Hypothesis], count: int, *, tied: float = 0.0) -> list[Hypothesis]:
    """The best fits with effects, one of each set of names; two single effects are among them.

    Args:
        found: fits.
        count: how many of the best, at most two single effects not counted.
        tied: another form of the same effects is kept too where its evidence is less than this below the best one's.
    """
    best: dict[frozenset[str], Hypothesis] = {}
    forms: dict[frozenset[str], Hypothesis] = {}
    for hypothesis in sorted(found, key=lambda h: -h.evidence):
        names = frozenset(hypothesis.names)
        first = best.setdefault(names, hypothesis)
        if hypothesis.effects and (hypothesis is first or hypothesis.evidence > first.evidence - tied):
            forms.setdefault(frozenset(effect.label for effect in hypothesis.effects), hypothesis)
    ranked = list(forms.values())
    chosen = ranked[:count]
    singles = [h for h in ranked if len(h.effects) == 1][: min(2, count)]
    return [*chosen, *(h for h in singles if h not in chosen)]


def evidence_of_anything(best: Hypothesis) -> float:
    """Of an unknown effect that leaves nothing but noise, at the price of as many doses as three effects have.

    It is the better explanation where even the best fit leaves much that does not look like noise.
    """
    price = 0.5 * _ANYTHING * np.log(max(best.independent, 2.0))
    return float((best.attainable / best.divisor).sum() - price)
