"""Which effects, one or several: forward selection from screenings, pairs that help only together, and leaving out.

1. Fit the effects that screening ranks first, each alone, and the pairs whose signatures explain most together; do
   so again from where the first frames alone put the base model (`physconvex.gap.search.first_frames`). Begin with
   damping where E was found together with it, and with a load at the end of a held body
   (`physconvex.gap.search.loads`). Where that led far from the base fit, numerical errors are told anew
   (`physconvex.gap.search.expected_errors`).
2. While something is left of the best fit, screen all other effects at that fit and add those that rank first.
3. Fit the best combination without each of its effects.
4. Carry the best few over to the full-order model (`physconvex.gap.search.space_mapping`), which decides.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from physconvex.gap.base.baseline import Baseline, Report
from physconvex.gap.effects.catalogue import applicable
from physconvex.gap.effects.effect import Effect
from physconvex.gap.errors.numerics import Numerics
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.errors.screening import Screening, screen
from physconvex.gap.options import GapOptions
from physconvex.gap.search.decision import decided
from physconvex.gap.search.evidence import residuals_per_one
from physconvex.gap.search.expected_errors import expect_anew
from physconvex.gap.search.flight import from_flight
from physconvex.gap.search.hypothesis import Hypothesis, base_hypothesis, continued
from physconvex.gap.search.loads import loaded_starts
from physconvex.gap.search.ranking import finalists, judged
from physconvex.gap.search.rounds import (
    alone,
    beside_in_first_frames,
    from_elsewhere,
    from_first_frames,
    from_there,
    leave_out,
    load_beside,
    one_more,
    polish,
    together,
)
from physconvex.gap.search.search_state import EffectSearch
from physconvex.gap.search.space_mapping import as_reduced
from physconvex.gap.thresholds import CLOCK, DECISION, RUN_COST, SEARCH

__all__ = ["Selected", "select_effects"]


@dataclass(frozen=True, eq=False)
class Selected:
    """What a search came to.

    Attributes:
        base: the base fit, as it was fitted on for the decision.
        hypotheses: the base model and the fits of effects, best evidence first.
        screening: at the base fit.
        errors: weights of the residuals: those given, or where a fit led far from the base fit those there.
        numerics: the differences that these are of.
    """

    base: Baseline
    hypotheses: list[Hypothesis]
    screening: Screening
    errors: ErrorModel
    numerics: Numerics


def select_effects(
    base: Baseline, errors: ErrorModel, numerics: Numerics, dictionary: Iterable[Effect], options: GapOptions,
    report: Report, *, screening: Screening | None = None, near: Baseline | None = None,
) -> Selected:  # fmt: skip
    """Search for the effects that explain a capture.

    Args:
        base: the full-order base fit.
        errors: weights of the residuals.
        numerics: for numerical effects.
        dictionary: effects to try.
        options: settings.
        report: told what is done.
        screening: at the base fit, if there is one already.
        near: the base model with an effect, near the recording: see `physconvex.gap.conditions.dissipation`.
    """
    cheap, dictionary = as_reduced(base), tuple(dictionary)
    screening = screening or screen(cheap, errors, numerics, dictionary, report)
    cost = cheap.model.cost
    cost.allow(options.search_cost * (RUN_COST.held if base.situation.clamped else 1.0), CLOCK.search_ends)
    search = EffectSearch(base, cheap, errors, options, report)
    search.found.append(base_hypothesis(cheap, errors))
    rows = len(base.rows(base.split.fitted))
    search.independent = rows / residuals_per_one(base, errors, base.positions, base.split.fitted)
    open_gap = search.found[0].fitted > SEARCH.closed or search.found[0].selecting > SEARCH.late
    if open_gap and near is not None and {effect.name for effect in near.model.effects} <= {e.name for e in dictionary}:
        from_there(search, base, near.model.effects, near.fit.values)
    if open_gap and base.situation.clamped:
        for effects, values in loaded_starts(cheap, errors, applicable(dictionary, base.situation)):
            from_there(search, base, effects, values)
    singles = screening.one_per_name[: SEARCH.singles]
    alone(search, singles)
    if open_gap:
        from_elsewhere(search, screening, singles)
        from_flight(search, numerics, dictionary)
        anew = expect_anew(search)
        if anew is not None:  # what the base fit leaves tells of another body
            numerics = anew
        else:
            together(search, screening)
            from_first_frames(search, numerics, dictionary)
        polish(search)
        load_beside(search, dictionary)
        for number in range(options.most_effects - 1):
            if not one_more(search, numerics, dictionary, SEARCH.stems if anew is None and not number else 1):
                break
        beside_in_first_frames(search, numerics, dictionary)
        leave_out(search)
    few = base.situation.clamped or not open_gap
    decisive = max(1, options.candidates // 2) if few else options.candidates
    forms = DECISION.forms if search.placed and open_gap else 1
    best = finalists(search.ranked, decisive, tied=DECISION.tied, forms=forms)
    chosen = judged(base, search.errors, decided(base, search.errors, numerics, best, options, report))
    plain = next(h for h in chosen if not h.effects)
    return Selected(continued(base, plain), chosen, screening, search.errors, numerics)
