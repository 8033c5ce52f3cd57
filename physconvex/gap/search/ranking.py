"""Fits of effects ranked: by evidence, without what no body can bear, and beside something that is in no dictionary."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.search.evidence import information_per_one
from physconvex.gap.search.hypothesis import Hypothesis, doses_at_bounds
from physconvex.gap.thresholds import EVIDENCE

__all__ = ["evidence_of_anything", "finalists", "judged", "within_bounds"]


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
