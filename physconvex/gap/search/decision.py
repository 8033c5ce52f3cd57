"""The full-order model decides between the best fits of the search (`physconvex.gap.search.mapping`)."""

from __future__ import annotations

from collections.abc import Sequence

from physconvex.gap.base.baseline import Baseline, Report
from physconvex.gap.errors.score import ErrorModel
from physconvex.gap.options import GapOptions
from physconvex.gap.search.comparison import Hypothesis, base_hypothesis
from physconvex.gap.search.mapping import confirmed, improved
from physconvex.gap.search.ranking import judged
from physconvex.gap.search.state import FAILURES, HELD

__all__ = ["decided"]

_DECIDED = 0.85  # of the deadline: then the full-order fits end
_SWEEPS, _SLOW = 5, 0.98  # over the full-order fits; share of the misfit above which another one is not worth it


def decided(
    base: Baseline, errors: ErrorModel, chosen: Sequence[Hypothesis], options: GapOptions, report: Report
) -> list[Hypothesis]:
    """The base model and the fits chosen, by the full-order model: as they were found, then fitted on while that helps.

    One for which there was no time is left out; if there was none for any, the reduced model's word is taken.
    """
    cost, out = base.model.cost, [base_hypothesis(base, errors)]
    cost.allow(options.decision_cost * (HELD if base.situation.clamped else 1.0), _DECIDED)
    for hypothesis in sorted(chosen, key=lambda h: len(h.effects)):  # the simple ones first, should time run out
        report(f"full-order run: {hypothesis.label}")
        try:
            if len(out) > 1:
                cost.check()
            out.append(confirmed(base, errors, hypothesis))
        except FAILURES as error:
            report(f"full-order run: {hypothesis.label}: {error}")
    settled: set[int] = set()  # ids of motions
    for _ in range(_SWEEPS):
        for hypothesis in [h for h in judged(base, errors, out) if h.effects and id(h.motion) not in settled]:
            report(f"full-order fit: {hypothesis.label}")
            try:
                better = improved(base, errors, hypothesis, options)
            except FAILURES as error:
                report(f"full-order fit: {hypothesis.label}: {error}")
                better = None
            if better is None:
                settled.add(id(hypothesis.motion))
                continue
            out[next(i for i, h in enumerate(out) if h.motion is hypothesis.motion)] = better
            if better.fitted > _SLOW * hypothesis.fitted or better.fitted < 1.0:
                settled.add(id(better.motion))
    return out if len(out) > 1 else [*out, *chosen[:1]]
