"""Expected errors from noise and numerical error, renewed if a fit moves far from the base fit.

Differences by mesh, steps and contact depend on the simulated body. If an effect shifts E of the base fit by a decade,
they are four times those at the body's own E, and hide a second effect.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from physconvex.gap.base.baseline import Baseline, Report
from physconvex.gap.base.model import MODULUS
from physconvex.gap.effects.catalogue import applicable
from physconvex.gap.effects.effect import Effect
from physconvex.gap.errors.error_model import error_model
from physconvex.gap.errors.numerical_differences import Numerics, numerical_differences
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.errors.screening import Screening, screen
from physconvex.gap.options import GapOptions
from physconvex.gap.search import rounds
from physconvex.gap.search.full_order import as_reduced, confirmed, decided
from physconvex.gap.search.hypothesis import Hypothesis, base_hypothesis, continued, finalists, judged, weighed_anew
from physconvex.gap.search.search_state import FAILURES, EffectSearch
from physconvex.gap.search.starting_points import from_flight, loaded_starts
from physconvex.gap.thresholds import CLOCK, DECISION, RUN_COST, SEARCH


def expect_anew(search: EffectSearch) -> Numerics | None:
    """Weight the fits of a free body by the differences at the best one, if its E is far from the base fit's.

    Errors, fits and budget of the search change. None, with nothing changed, if E has not moved or no model can be run
    there.
    """
    base, best = search.full, search.best
    names = base.model.base
    if base.situation.clamped or MODULUS not in names or not best.effects or search.late:
        return None
    place = names.index(MODULUS)
    if abs(best.values[place] - base.fit.values[place]) <= SEARCH.far_modulus:
        return None
    search.report(f"what is expected, at {best.label}")
    cost = base.model.cost
    before = cost.spent
    try:
        point = continued(base, confirmed(base, search.errors, best))
    except FAILURES:
        return None
    numerics = numerical_differences(point, search.options, search.report)
    search.errors = error_model(point, numerics, search.options)
    search.found = [weighed_anew(search.base, search.errors, h) for h in search.found]
    cost.limit += cost.spent - before + RUN_COST.after_moving * search.options.search_cost
    return numerics


@dataclass(frozen=True, eq=False)
class Selected:
    """Result of a search.

    Attributes:
        base: the base fit, as refined for the decision.
        hypotheses: the base model and the fits of effects, best evidence first.
        screening: screening at the base fit.
        errors: weights of the residuals: the given ones, or those at a fit far from the base fit.
        numerics: the differences behind these errors.
    """

    base: Baseline
    hypotheses: list[Hypothesis]
    screening: Screening
    errors: ErrorModel
    numerics: Numerics


def select_effects(
    base: Baseline, errors: ErrorModel, numerics: Numerics, dictionary: Iterable[Effect], *, options: GapOptions,
    report: Report, screening: Screening | None = None, near: Baseline | None = None,
) -> Selected:  # fmt: skip
    """Search for the effects that explain a capture.

    Args:
        base, errors: the full-order base fit, and the weights of its residuals.
        numerics: differences for numerical effects.
        dictionary: effects to try.
        options, report: settings, and what receives progress messages.
        screening: screening at the base fit, if known.
        near: the base model with an effect, near the recording: see `physconvex.gap.conditions.joint_fits`.
    """
    cheap, dictionary = as_reduced(base), tuple(dictionary)
    screening = screening or screen(cheap, errors, numerics, dictionary, report)
    cost = cheap.model.cost
    cost.allow(options.search_cost * (RUN_COST.held if base.situation.clamped else 1.0), CLOCK.search_ends)
    search = EffectSearch(base, cheap, errors, options, report)
    search.found.append(base_hypothesis(cheap, errors))
    open_gap = search.found[0].fitted > SEARCH.closed or search.found[0].selecting > SEARCH.late
    if open_gap and near is not None and {effect.name for effect in near.model.effects} <= {e.name for e in dictionary}:
        rounds.from_there(search, base, near.model.effects, near.fit.values)
    if open_gap and base.situation.clamped:
        for effects, values in loaded_starts(cheap, errors, applicable(dictionary, base.situation)):
            rounds.from_there(search, base, effects, values)
    singles = screening.one_per_name[: SEARCH.singles]
    rounds.alone(search, singles)
    if open_gap:
        rounds.from_elsewhere(search, screening, singles)
        from_flight(search, numerics, dictionary)
        anew = expect_anew(search)
        if anew is not None:  # the residual of the base fit belongs to another body
            numerics = anew
        else:
            rounds.together(search, screening)
            rounds.from_first_frames(search, numerics, dictionary)
        rounds.polish(search)
        rounds.load_beside(search, dictionary)
        for number in range(options.most_effects - 1):
            stems = SEARCH.stems if anew is None and not number else 1
            if not rounds.one_more(search, numerics, dictionary, stems):
                break
        rounds.beside_in_first_frames(search, numerics, dictionary)
        rounds.leave_out(search)
    few = base.situation.clamped or not open_gap
    decisive = max(1, options.candidates // 2) if few else options.candidates
    forms = DECISION.forms if search.placed and open_gap else 1
    best = finalists(search.ranked, decisive, tied=DECISION.tied, forms=forms)
    chosen = judged(base, search.errors, decided(base, search.errors, numerics, best, options=options, report=report))
    plain = next(h for h in chosen if not h.effects)
    return Selected(continued(base, plain), chosen, screening, search.errors, numerics)
