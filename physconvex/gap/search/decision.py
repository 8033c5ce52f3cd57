"""The full-order model decides between the best fits of the search (`physconvex.gap.search.space_mapping`)."""

from __future__ import annotations

from collections.abc import Sequence

from physconvex.gap.base.baseline import Baseline, Report
from physconvex.gap.errors.numerics import Numerics
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.options import GapOptions
from physconvex.gap.search.exact_corrections import with_own_correction
from physconvex.gap.search.hypothesis import Hypothesis, base_hypothesis
from physconvex.gap.search.ranking import judged
from physconvex.gap.search.search_state import FAILURES
from physconvex.gap.search.space_mapping import confirmed, improved
from physconvex.gap.thresholds import CLOCK, DECISION

__all__ = ["decided"]


def decided(
    base: Baseline, errors: ErrorModel, numerics: Numerics, chosen: Sequence[Hypothesis], options: GapOptions,
    report: Report,
) -> list[Hypothesis]:  # fmt: skip
    """The base model and the fits chosen, by the full-order model: as they were found, then fitted on while that helps.

    Each is corrected by the most exact run at its own values, the base model too, which is then fitted on as well.
    One for which there was no time is left out; if there was none for any, the reduced model's word is taken.
    """
    cost, plain = base.model.cost, base_hypothesis(base, errors)
    cost.allow(options.decision_cost, CLOCK.decision_ends)
    out = [plain]
    for hypothesis in sorted(chosen, key=lambda h: len(h.effects)):  # the simple ones first, should time run out
        report(f"full-order run: {hypothesis.label}")
        try:
            if len(out) > 1:
                cost.check()
            out.append(confirmed(base, errors, hypothesis))
        except FAILURES as error:
            report(f"full-order run: {hypothesis.label}: {error}")
    if numerics.exact is not None:
        near = {id(h.motion) for h in _near_the_best(base, errors, out)} | {id(plain.motion)}
        out = [_corrected(base, errors, numerics, h, report) if id(h.motion) in near else h for h in out]
        settled = {id(h.motion) for h in out} - near  # ids of motions
    else:
        settled = {id(plain.motion)}
    for _ in range(DECISION.sweeps):
        for hypothesis in [h for h in judged(base, errors, out) if id(h.motion) not in settled]:
            report(f"full-order fit: {hypothesis.label}")
            try:
                better = improved(base, errors, hypothesis, options)
            except FAILURES as error:
                report(f"full-order fit: {hypothesis.label}: {error}")
                better = None
            if better is None:
                settled.add(id(hypothesis.motion))
                continue
            better = _corrected(base, errors, numerics, better, report)
            out[next(i for i, h in enumerate(out) if h.motion is hypothesis.motion)] = better
            if better.seen < hypothesis.seen + DECISION.slow:
                settled.add(id(better.motion))
    return out if len(out) > 1 else [*out, *chosen[:1]]


def _near_the_best(base: Baseline, errors: ErrorModel, fits: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Fits that may yet be the best, best first."""
    ranked = judged(base, errors, fits)
    return [h for h in ranked if h.evidence > ranked[0].evidence - DECISION.hopeless]


def _corrected(
    base: Baseline, errors: ErrorModel, numerics: Numerics, found: Hypothesis, report: Report
) -> Hypothesis:  # fmt: skip
    """A fit with its own correction, or as it is where that run fails, or has no time left."""
    try:
        return with_own_correction(base, errors, numerics, found)
    except FAILURES as error:
        report(f"most exact run: {found.label}: {error}")
        return found
