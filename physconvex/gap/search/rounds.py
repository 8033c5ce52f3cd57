"""The rounds of a search: the next effects to fit, and their start values."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.base.model import EffectModel
from physconvex.gap.effects.catalogue import applicable
from physconvex.gap.effects.effect import Effect
from physconvex.gap.errors.numerical_differences import Numerics
from physconvex.gap.errors.screening import Pair, Screened, Screening, best_pairs, screen
from physconvex.gap.search.effect_fits import derivatives_at, refit
from physconvex.gap.search.evidence import residuals_per_one
from physconvex.gap.search.full_order import as_reduced, confirmed, fitted_there, improved
from physconvex.gap.search.hypothesis import Hypothesis, continued, finalists, hypothesis_at
from physconvex.gap.search.search_state import FAILURES, EffectSearch
from physconvex.gap.search.starting_points import early_point, loaded_starts
from physconvex.gap.thresholds import DECISION, RUN_COST, SCREENING, SEARCH


def alone(search: EffectSearch, screened: Iterable[Screened]) -> None:
    """Fit each effect alone; if the clock ends this round, effects with a high rank are untried."""
    cost = search.base.model.cost
    for entry in screened:
        cost.hurried |= cost.out_of_time
        search.fit([entry])


def from_elsewhere(search: EffectSearch, screening: Screening, tried: Sequence[Screened]) -> None:
    """Fit effects that have a place or a direction from other places and directions as well.

    Screening hardly separates these for a struck body: E absorbs a stiff core, and a soft end looks similar.
    """
    if search.placed:
        for entry in other_places(screening, tried):
            search.fit([entry])


def other_places(screening: Screening, tried: Sequence[Screened]) -> list[Screened]:
    """The best untried forms of the same effects, for those with a place or a direction."""
    found = []
    for name in [entry.effect.name for entry in tried]:
        placed = [e for e in screening.ranked if e.effect.name == name and any(d.shape for d in e.effect.doses)]
        found += [e for e in placed if e not in tried][: SEARCH.elsewhere]
    return found


def from_there(search: EffectSearch, full: Baseline, effects: tuple[Effect, ...], values: np.ndarray) -> None:
    """Fit effects from values that are found together with E."""
    label = " + ".join(effect.label for effect in effects)
    model = replace(full.model, effects=effects)
    search.attempt(f"{label}, from a scan", lambda: fitted_there(search, model, values))


def load_beside(search: EffectSearch, dictionary: tuple[Effect, ...]) -> None:
    """A load at the end of a held body beside the best effects: E must change with it, so no dose alone helps."""
    best = search.best
    if not search.base.situation.clamped or not best.effects or "attached_mass" in best.names:
        return
    if search.wanting(best):
        point = continued(search.base, best)
        for effects, values in loaded_starts(point, search.errors, applicable(dictionary, point.situation)):
            if len(effects) <= search.options.most_effects:
                from_there(search, search.base, effects, values)


def together(search: EffectSearch, screening: Screening) -> None:
    """Pairs that explain much more than the better of the two, if single effects leave a gap."""
    if not search.open(search.best):
        return
    full, fitted = search.full, search.full.split.fitted
    independent = len(full.rows(fitted)) / residuals_per_one(full, search.errors, full.positions, fitted)
    for pair in plausible_pairs(screening, independent, held=full.situation.clamped)[: SEARCH.pairs]:
        search.fit([pair.first, pair.second])


def plausible_pairs(screening: Screening, independent: float, *, held: bool) -> list[Pair]:
    """Pairs by the part of the independent residuals that they explain, less the prior penalty of their doses.

    For a held body, half of them include damping. Every recording decays, and damping may hide another effect.
    """
    pairs = best_pairs(screening, SCREENING.pairs_ranked)

    def worth(pair: Pair) -> float:
        left = max(1.0 - pair.statistic / max(float(screening.left @ screening.left), 1e-300), 1e-3)
        both = (pair.first, pair.second)
        odd = sum(d.implausibility(v) for e in both for d, v in zip(e.effect.doses, e.doses, strict=True))
        return -0.5 * independent * float(np.log(left)) - odd

    if not held:
        return pairs
    ranked = sorted(pairs, key=lambda pair: -worth(pair))
    damped = [p for p in ranked if "damping" in (p.first.effect.name, p.second.effect.name)][: SEARCH.pairs // 2]
    return [*damped, *(p for p in ranked if p not in damped)]


def from_first_frames(search: EffectSearch, numerics: Numerics, dictionary: tuple[Effect, ...]) -> None:
    """Screen and fit again from the base model of the first frames alone, if that differs."""
    if search.open(search.best) and not search.late:
        _early(search, search.base, numerics, dictionary)


def beside_in_first_frames(search: EffectSearch, numerics: Numerics, dictionary: tuple[Effect, ...]) -> None:
    """The same beside the best effects, if these leave a gap or diverge from the recording after the fitted frames.

    Over all fitted frames E absorbs a second effect like a first one; the difference shows later.
    """
    best = search.best
    if best.effects and search.wanting(best):
        _early(search, continued(search.base, best), numerics, dictionary)
        polish(search)


def _early(search: EffectSearch, base: Baseline, numerics: Numerics, dictionary: tuple[Effect, ...]) -> None:
    """Fits from the first frames of a baseline."""
    point = early_point(base, search.errors, search.options, search.report)
    if point is not None and not search.base.model.cost.over:
        screening = screen(point, search.errors, numerics, dictionary, search.report)
        for entry in screening.one_per_name[: SEARCH.early]:
            search.fit([entry], starts=point)


def one_more(search: EffectSearch, numerics: Numerics, dictionary: tuple[Effect, ...], stems: int) -> bool:
    """Screen at the best fits and add one effect to each; return whether the evidence increases enough."""
    found = [_in_full(search, stem) for stem in finalists(search.ranked, stems)[:stems] if search.wanting(stem)]
    before = search.best
    for stem in filter(search.wanting, found):
        point = continued(search.base, stem)
        screening = screen(point, search.errors, numerics, dictionary, search.report)
        for entry in screening.one_per_name[: SEARCH.added]:
            search.fit([entry], starts=point)
    polish(search)
    ranked = search.ranked
    again = [h.evidence for h in ranked if h.motion is before.motion]  # by the residual of the current best fit
    return not again or ranked[0].evidence > again[0] + SEARCH.worth


def _in_full(search: EffectSearch, stem: Hypothesis) -> Hypothesis:
    """A refinement of a fit by a reduced model that is corrected to the full-order one at this fit.

    The correction at the base fit is wrong for a strong effect. For a body thrown with another spin, the reduced
    model's own error hides the whole residual of damping.
    """
    if search.base.situation.clamped or not stem.effects:
        return stem
    search.report(f"full-order fit: {stem.label}")
    try:
        here = confirmed(search.full, search.errors, stem)
        here = improved(search.full, search.errors, here, search.options) or here
        point = as_reduced(continued(search.full, here))
    except FAILURES as error:
        search.report(f"full-order fit: {stem.label}: {error}")
        return stem
    found = hypothesis_at(
        search.base, search.errors, point.model, here.values, here.errors, motion=point.motion, tangents=here.tangents
    ).tempered(stem.divisor)
    search.found = [*(h for h in search.found if h.motion is not stem.motion), found]
    return found


def polish(search: EffectSearch) -> None:
    """Fit the best ones again, with derivatives at their current values."""
    for hypothesis in finalists(search.ranked, SEARCH.polished, tied=DECISION.tied)[: SEARCH.polished]:
        if id(hypothesis.motion) in search.polished or search.late:
            continue

        def again(h: Hypothesis = hypothesis) -> Hypothesis:
            tangents = derivatives_at(search.base, h.model, h.values, h.motion)
            return refit(search.base, search.errors, h.model, h.values, tangents, options=search.options)

        found = search.attempt(f"{hypothesis.label}, again", again)
        search.polished |= {id(hypothesis.motion)} | ({id(found.motion)} if found is not None else set())


def leave_out(search: EffectSearch) -> None:
    """Fit the best combination without each of its effects, if nothing is far ahead of it (parsimony).

    Fits of fewer effects that ended at a clearly larger misfit are repeated. A load alone may stop at three times the
    squares, while a wrong frame rate that leads to the load ranks first. This round has a reserved budget.
    """
    ranked = search.ranked
    best = next((h for h in ranked if len(h.effects) > 1 and h.evidence > ranked[0].evidence - SEARCH.worth), None)
    if best is None:
        return
    cost = search.base.model.cost
    cost.limit = max(cost.limit, cost.spent + RUN_COST.leaving_out * search.options.search_cost)
    for start in without_each(best, search.found):
        again = partial(refit, search.base, search.errors, *start, options=search.options)
        search.attempt(" + ".join(effect.label for effect in start[0].effects), again)


def without_each(best: Hypothesis, found: Sequence[Hypothesis]) -> Iterator[tuple[EffectModel, np.ndarray, np.ndarray]]:
    """Model, values and derivatives of a combination without each of its effects in turn.

    Skipped if a fit of the others is already known with nearly the same likelihood.
    """
    for index, effect in enumerate(best.effects):
        rest = tuple(e for e in best.effects if e is not effect)
        if any(set(h.effects) == set(rest) and h.seen >= best.seen - SEARCH.as_good for h in found):
            continue
        where = best.model.slices[index]
        keep = np.r_[0 : where.start, where.stop : len(best.values)]
        yield replace(best.model, effects=rest), best.values[keep], best.tangents[:, keep]
