"""Which effects, one or several: forward selection from screenings, pairs that help only together, and leaving out.

1. Fit the effects that screening ranks first, each alone, and the pairs whose signatures explain most together; do
   so again from where the first frames alone put the base model (`physconvex.gap.search.anchoring`). Begin with
   damping where E was found together with it, and with a load at the end of a held body
   (`physconvex.gap.search.loads`).
2. While something is left of the best fit, screen all other effects at that fit and add those that rank first.
3. Fit the best combination without each of its effects.
4. Carry the best few over to the full-order model (`physconvex.gap.search.mapping`), which decides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.baseline import Baseline, Report
from physconvex.gap.base.model import EffectModel, reduced_like
from physconvex.gap.effects import Effect, applicable
from physconvex.gap.errors.numerics import Numerics
from physconvex.gap.errors.score import ErrorModel
from physconvex.gap.errors.screening import Pair, Screened, Screening, best_pairs, screen
from physconvex.gap.options import GapOptions
from physconvex.gap.search.anchoring import early_point
from physconvex.gap.search.comparison import (
    Hypothesis,
    base_hypothesis,
    continued,
    doses_at_bounds,
    fit_effects,
    hypothesis_at,
    refit,
)
from physconvex.gap.search.evidence import information_per_one, residuals_per_one
from physconvex.gap.search.loads import loaded_starts
from physconvex.gap.search.mapping import as_reduced, confirmed, improved

__all__ = ["FAILURES", "Selection", "evidence_of_anything", "plausible_pairs", "select_effects", "within_bounds"]

# of a run with doses that no body can bear: such a fit is left out, and the report says so
FAILURES = (ConvergenceError, InputError, np.linalg.LinAlgError)
_SEARCHED, _DECIDED = 0.6, 0.85  # of the deadline: then the search ends, then the full-order fits
_LONGEST = 0.15  # of the cost of the search that a single fit may take
_CLOSED = 1.5  # mean square over the expected one below which there is no gap to explain
_LATE_GAP = 5.0  # the same of the frames that choose: an impact near the end of the fitted ones shows after them
_WIDE = 3.0  # mean square over the expected one from which on a further effect is looked for in any case
_LEFT = 6.0  # log-likelihood that is left to gain, above which a further effect is looked for
_SINGLES, _PAIRS, _ADDED, _EARLY = 7, 4, 3, 4  # fits: alone, two at once, in each further round, from the first frames
_STEMS, _POLISHED = 2, 3  # fits that the first further round goes on from; fits with derivatives taken anew
_HELD = 0.7  # of the costs allowed, for a held body: its screening and its base fit cost more
_ANYTHING = 8  # doses and effects that an unknown effect is priced at
_MANY = 40  # pairs that are ranked
_WORTH = 4.0  # gain of evidence for which the search goes on
_SWEEPS, _SLOW = 5, 0.98  # over the full-order fits; share of the misfit above which another one is not worth it
_TIED = 1.0  # difference of evidence that hardly tells two forms of an effect apart


@dataclass(eq=False)
class Selection:
    """A search in progress.

    Attributes:
        full: base fit, of the full-order model.
        base: the same of the reduced one.
        errors: weights of the residuals.
        options: settings.
        report: told what is done.
        found: fits so far, the base model first.
        polished: ids of the motions of fits that need not be fitted again.
        independent: number of independent residuals in what the base model leaves.
    """

    full: Baseline
    base: Baseline
    errors: ErrorModel
    options: GapOptions
    report: Report
    found: list[Hypothesis] = field(default_factory=list)
    polished: set[int] = field(default_factory=set)
    independent: float = 1.0

    @property
    def best(self) -> Hypothesis:
        """By tempered evidence."""
        return self.ranked[0]

    @property
    def ranked(self) -> list[Hypothesis]:
        """Fits so far by tempered evidence, best first."""
        return judged(self.base, self.errors, self.found)

    @property
    def late(self) -> bool:
        """Whether the runs so far have cost what they may."""
        return self.base.model.cost.over

    def wanting(self, fit: Hypothesis) -> bool:
        """Whether a further effect is worth looking for beside those of a fit."""
        room = len(fit.effects) < self.options.most_effects
        return room and not self.late and self.open(fit)

    def open(self, fit: Hypothesis) -> bool:
        """Whether a fit leaves something to explain.

        What is left of a wide gap is smooth, and counts as few independent residuals: it is open all the same. So is
        one that opens in the frames that choose. Not of held bodies: what holds a real one, and how it is let go, leave
        a wide gap always.
        """
        wide = fit.fitted > _WIDE or fit.selecting > _LATE_GAP
        return fit.left_to_explain >= _LEFT or (wide and not self.base.situation.clamped)

    def attempt(self, text: str, run: Callable[[], Hypothesis]) -> Hypothesis | None:
        """Fit and keep, unless it fails or the runs have cost too much; the first one is begun all the same."""
        if self.late and len(self.found) > 1:
            return None
        self.report(f"fit: {text}")
        try:
            with self.base.model.cost.at_most(_LONGEST * self.options.search_cost):
                hypothesis = run()
        except FAILURES:
            self.report(f"fit: {text} failed")
            return None
        if not np.isfinite(hypothesis.positions).all():
            return None
        self.found.append(hypothesis)
        return hypothesis

    def fit(self, chosen: Sequence[Screened], starts: Baseline | None = None) -> Hypothesis | None:
        """Fit screened effects, beside those of `starts`."""
        kept = () if starts is None else tuple(e.label for e in starts.model.effects)
        text = " + ".join([*kept, *(entry.effect.label for entry in chosen)])
        return self.attempt(text, lambda: fit_effects(self.base, self.errors, chosen, self.options, starts=starts))


def select_effects(
    base: Baseline, errors: ErrorModel, numerics: Numerics, dictionary: Iterable[Effect], options: GapOptions,
    report: Report, *, screening: Screening | None = None, near: Baseline | None = None,
) -> tuple[list[Hypothesis], Screening]:  # fmt: skip
    """The base model and the fits of effects, best evidence first, and the screening at the base fit.

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
    cost.allow(options.search_cost * (_HELD if base.situation.clamped else 1.0), _SEARCHED)
    search = Selection(base, cheap, errors, options, report)
    search.found.append(base_hypothesis(cheap, errors))
    rows = len(base.rows(base.split.fitted))
    search.independent = rows / residuals_per_one(base, errors, base.positions, base.split.fitted)
    open_gap = search.found[0].fitted > _CLOSED or search.found[0].selecting > _LATE_GAP
    if open_gap and near is not None and {effect.name for effect in near.model.effects} <= {e.name for e in dictionary}:
        _from_there(search, base, near.model.effects, near.fit.values)
    if open_gap and base.situation.clamped:
        for effects, values in loaded_starts(cheap, errors, applicable(dictionary, base.situation)):
            _from_there(search, base, effects, values)
    _alone(search, screening.one_per_name[: _SINGLES if open_gap else 2])
    if open_gap:
        _together(search, screening)
        _from_first_frames(search, numerics, dictionary)
        _polish(search)
        _load_beside(search, dictionary)
        for number in range(options.most_effects - 1):
            if not _one_more(search, numerics, dictionary, 1 if number else _STEMS):
                break
        _beside_in_first_frames(search, numerics, dictionary)
        _leave_out(search)
    finalists = _finalists(search.ranked, options.candidates if open_gap else 1, tied=_TIED)
    return judged(base, errors, _decided(base, errors, finalists, options, report)), screening


def _decided(
    base: Baseline, errors: ErrorModel, finalists: Sequence[Hypothesis], options: GapOptions, report: Report
) -> list[Hypothesis]:
    """The base model and the finalists by the full-order model: each as it was found, then fitted on while that helps.

    A finalist for which there was no time is left out; if there was none for any, the reduced model's word is taken.
    """
    cost, out = base.model.cost, [base_hypothesis(base, errors)]
    cost.allow(options.decision_cost * (_HELD if base.situation.clamped else 1.0), _DECIDED)
    for hypothesis in sorted(finalists, key=lambda h: len(h.effects)):  # the simple ones first, should time run out
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
    return out if len(out) > 1 else [*out, *finalists[:1]]


def evidence_of_anything(best: Hypothesis) -> float:
    """Of an unknown effect that leaves nothing but noise, at the price of as many doses as three effects have.

    It is the better explanation where even the best fit leaves much that does not look like noise.
    """
    price = 0.5 * _ANYTHING * np.log(max(best.independent, 2.0))
    return float((best.attainable / best.divisor).sum() - price)


def within_bounds(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Without fits that need a dose at the bound of what is physical, as long as others with effects are left."""
    kept = [h for h in hypotheses if not doses_at_bounds(h)]
    return kept if any(h.effects for h in kept) else list(hypotheses)


def _finalists(found: Sequence[Hypothesis], count: int, *, tied: float = 0.0) -> list[Hypothesis]:
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


def judged(base: Baseline, errors: ErrorModel, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """With the evidence of as many residuals as are independent in what the best of them leaves, best first.

    Fits with a dose at its bound are left out as long as others with effects are there.
    """
    hypotheses = within_bounds(hypotheses)
    best = max(hypotheses, key=lambda h: h.evidence)
    divisor = information_per_one(base, errors, best.positions)
    return sorted((h.tempered(divisor) for h in hypotheses), key=lambda h: -h.evidence)


def _alone(search: Selection, screened: Iterable[Screened]) -> None:
    """Each by itself; a search that the clock ends here has not seen what the recording asks for."""
    cost = search.base.model.cost
    for entry in screened:
        cost.hurried |= cost.out_of_time
        search.fit([entry])


def _from_there(search: Selection, full: Baseline, effects: tuple[Effect, ...], values: np.ndarray) -> None:
    """Fit effects from values at which they were found together with E."""
    count = int(search.base.split.fitted[-1]) + 1

    def run() -> Hypothesis:
        model = replace(full.model, effects=effects)
        cheap, motion = reduced_like(model, model.motion(values), values)
        tangents = replace(cheap, frames=count).tangents(values, motion.first(count))
        return refit(search.base, search.errors, cheap, values, tangents, search.options)

    search.attempt(" + ".join(effect.label for effect in effects) + ", from a scan", run)


def _load_beside(search: Selection, dictionary: tuple[Effect, ...]) -> None:
    """A load at the end of a held body beside the best effects: E has to move with it, so that no dose alone helps."""
    best = search.best
    if not search.base.situation.clamped or not best.effects or "attached_mass" in best.names:
        return
    if search.wanting(best):
        point = continued(search.base, best)
        for effects, values in loaded_starts(point, search.errors, applicable(dictionary, point.situation)):
            if len(effects) <= search.options.most_effects:
                _from_there(search, search.base, effects, values)


def _together(search: Selection, screening: Screening) -> None:
    """Pairs that explain much more than the better of the two, where single effects leave something."""
    if not search.open(search.best):
        return
    for pair in plausible_pairs(screening, search.independent, held=search.base.situation.clamped)[:_PAIRS]:
        search.fit([pair.first, pair.second])


def plausible_pairs(screening: Screening, independent: float, *, held: bool) -> list[Pair]:
    """Pairs by what they explain of so many independent residuals, less what is implausible of their doses.

    Of a held body, half of them have damping: nothing rings for ever, so that another effect adds to it in any
    recording, and may not show before it is there.
    """
    pairs = best_pairs(screening, _MANY)

    def worth(pair: Pair) -> float:
        left = max(1.0 - pair.statistic / max(screening.lack_of_fit, 1e-300), 1e-3)
        both = (pair.first, pair.second)
        odd = sum(d.implausibility(v) for e in both for d, v in zip(e.effect.doses, e.doses, strict=True))
        return -0.5 * independent * float(np.log(left)) - odd

    if not held:
        return pairs
    ranked = sorted(pairs, key=lambda pair: -worth(pair))
    damped = [p for p in ranked if "damping" in (p.first.effect.name, p.second.effect.name)][: _PAIRS // 2]
    return [*damped, *(p for p in ranked if p not in damped)]


def _from_first_frames(search: Selection, numerics: Numerics, dictionary: tuple[Effect, ...]) -> None:
    """Screen and fit again from where the first frames alone put the base model, if that is elsewhere."""
    if search.open(search.best) and not search.late:
        _early(search, search.base, numerics, dictionary)


def _beside_in_first_frames(search: Selection, numerics: Numerics, dictionary: tuple[Effect, ...]) -> None:
    """The same beside the best effects, where these leave something or part from the recording after the fitted frames.

    Over all fitted frames E absorbs a second effect as it does a first one; what that does comes out later.
    """
    best = search.best
    if best.effects and search.wanting(best):
        _early(search, continued(search.base, best), numerics, dictionary)
        _polish(search)


def _early(search: Selection, base: Baseline, numerics: Numerics, dictionary: tuple[Effect, ...]) -> None:
    """Fits from the first frames of a baseline."""
    point = early_point(base, search.errors, search.options, search.report)
    if point is not None and not search.base.model.cost.over:
        screening = screen(point, search.errors, numerics, dictionary, search.report)
        for entry in screening.one_per_name[:_EARLY]:
            search.fit([entry], starts=point)


def _one_more(search: Selection, numerics: Numerics, dictionary: tuple[Effect, ...], stems: int) -> bool:
    """Screen at the best fits, add one effect to each; tells whether that was worth it."""
    found = [_in_full(search, stem) for stem in _finalists(search.ranked, stems)[:stems] if search.wanting(stem)]
    before = search.best
    for stem in filter(search.wanting, found):
        point = continued(search.base, stem)
        screening = screen(point, search.errors, numerics, dictionary, search.report)
        for entry in screening.one_per_name[:_ADDED]:
            search.fit([entry], starts=point)
    _polish(search)
    ranked = search.ranked
    again = [h.evidence for h in ranked if h.motion is before.motion]  # by what the best fit leaves now
    return not again or ranked[0].evidence > again[0] + _WORTH


def _in_full(search: Selection, stem: Hypothesis) -> Hypothesis:
    """A fit in which the reduced model says what the full-order one does there, which is fitted a little further.

    What the two differ by at the base fit is soon out of date where an effect is strong: of a body that is thrown with
    another spin, the reduced model's own error hid all that a damping left.
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
        search.base, search.errors, point.model, here.values, here.errors, point.motion, here.tangents
    ).tempered(stem.divisor)
    search.found = [*(h for h in search.found if h.motion is not stem.motion), found]
    return found


def _polish(search: Selection) -> None:
    """Fit the best ones again, with derivatives taken where they are now."""
    for hypothesis in _finalists(search.ranked, _POLISHED, tied=_TIED)[:_POLISHED]:
        if id(hypothesis.motion) in search.polished or search.late:
            continue
        count = int(search.base.split.fitted[-1]) + 1
        shorter = replace(hypothesis.model, frames=count)

        def again(h: Hypothesis = hypothesis, model: EffectModel = shorter, count: int = count) -> Hypothesis:
            tangents = model.tangents(h.values, h.motion.first(count))
            return refit(search.base, search.errors, h.model, h.values, tangents, search.options)

        found = search.attempt(f"{hypothesis.label}, again", again)
        search.polished |= {id(hypothesis.motion)} | ({id(found.motion)} if found is not None else set())


def _leave_out(search: Selection) -> None:
    """Fit the best combination without each of its effects, so that parsimony has a say."""
    best = search.best
    if len(best.effects) < 2:
        return
    for index, effect in enumerate(best.effects):
        rest = tuple(e for e in best.effects if e is not effect)
        if any(set(h.effects) == set(rest) for h in search.found):
            continue
        where = best.model.slices[index]
        keep = np.r_[0 : where.start, where.stop : len(best.values)]
        model = replace(best.model, effects=rest)
        values, tangents = best.values[keep], best.tangents[:, keep]
        search.attempt(
            " + ".join(e.label for e in rest),
            lambda m=model, v=values, t=tangents: refit(search.base, search.errors, m, v, t, search.options),  # type: ignore[misc]
        )
