"""Pairs of effects that explain a residual only together."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from physconvex import ConvergenceError
from physconvex.gap import DEFAULT_EFFECTS, GapOptions, Score
from physconvex.gap.base.cost import Cost
from physconvex.gap.errors.screening import Screened, Screening, best_pairs
from physconvex.gap.search import full_order, rounds, search_state as state
from physconvex.gap.search.hypothesis import finalists

pytestmark = pytest.mark.wrong_types  # stand-ins for models and fits


def effect(name):
    return next(e for e in DEFAULT_EFFECTS if e.name == name)


def entry(name, row, left):
    one = effect(name)
    amount = max(row @ left / (row @ row), 0.0)
    score = Score(amount**2 * (row @ row), 1, 0.1, np.array([amount]), np.array([0.1]), 1.0, 0.1)
    trials = np.array([[d.null + 0.1 for d in one.doses]])
    return Screened(one, score, trials[0].copy(), np.full(len(one.doses), 0.1), row[None, None, None], trials, row,
                    row[None], (1,))  # fmt: skip


@pytest.fixture
def screening(rng):
    first, second, third = np.linalg.qr(rng.normal(size=(60, 3)))[0].T
    left = 10 * second
    entries = [
        entry("friction", first + second, left),  # each of the two drags in a direction that only the other undoes
        entry("damping", 0.3 * second - first, left),
        entry("restitution", 0.8 * second + third, left),
    ]
    ranked = tuple(sorted(entries, key=lambda e: -e.score.statistic))
    return Screening(ranked, (), float(left @ left), 57, left)


def test_a_pair_that_helps_only_together_comes_first(screening):
    pair = best_pairs(screening, 1)[0]
    assert {pair.first.effect.name, pair.second.effect.name} == {"damping", "friction"}
    assert pair.statistic == pytest.approx(screening.lack_of_fit, rel=1e-6)
    assert pair.gain > 0.3 * screening.lack_of_fit
    doses = {p.effect.name: p.doses[0] for p in (pair.first, pair.second)}
    assert doses["friction"] == pytest.approx(0.1 * 10 / 1.3, rel=1e-4)


def test_pairs_are_named_once(screening):
    names = [frozenset((p.first.effect.name, p.second.effect.name)) for p in best_pairs(screening, 9)]
    assert len(names) == len(set(names)) <= 3


def test_what_is_somewhere_in_a_struck_body_is_fitted_from_several_places():
    """From the one place that screened best, a stiff core (2301/034) stopped behind an air drag that does nothing."""
    labels = [e.label for e in DEFAULT_EFFECTS if e.name in ("heterogeneity", "friction")]
    ranked = tuple(SimpleNamespace(effect=e) for e in DEFAULT_EFFECTS if e.label in labels)
    screening, tried = SimpleNamespace(ranked=ranked), [ranked[0], ranked[-1]]
    fits = []
    search = SimpleNamespace(placed=True, fit=lambda chosen: fits.append(chosen[0]))
    rounds.from_elsewhere(search, screening, tried)
    assert len(fits) == 4 and not any(entry in tried for entry in fits)
    assert all(entry.effect.variant.startswith("inclusion") for entry in fits)
    search.placed = False
    rounds.from_elsewhere(search, screening, tried)
    assert len(fits) == 4


@pytest.mark.parametrize(("clamped", "points", "placed"), [(False, 20, True), (False, 1, False), (True, 20, False)])
def test_places_are_tried_where_the_recording_tells_how_a_struck_body_deforms(clamped, points, placed):
    """The middle of a rolling ball tells no direction of fibres: their fits took what a search may cost. What bends as
    a whole tells the place.
    """  # fmt: skip
    base = SimpleNamespace(situation=SimpleNamespace(clamped=clamped), positions=np.zeros((9, points, 3)))
    assert state.EffectSearch(None, base, None, None, None).placed == placed


def fitted(evidence, *labels, slight=False):
    names = tuple(label.split(" (")[0] for label in labels)
    effects = tuple(SimpleNamespace(label=one) for one in labels)
    return SimpleNamespace(effects=effects, names=names, evidence=evidence, is_slight=lambda: slight)


def test_the_best_single_effects_are_carried_over():
    found = [fitted(0), fitted(9, "a", "b"), fitted(8, "a", "c"), fitted(5, "a"), fitted(4, "a"), fitted(3, "c")]
    chosen = finalists(found, 2)
    assert [h.names for h in chosen] == [("a", "b"), ("a", "c"), ("a",), ("c",)] and chosen[2].evidence == 5


def test_a_form_that_is_as_likely_is_carried_over():
    found = [fitted(9.0, "a (x)", "b"), fitted(8.7, "a (y)", "b"), fitted(8.6, "a (y)", "b"), fitted(6.0, "a (z)", "b")]
    assert [h.evidence for h in finalists(found, 4, tied=1.0)] == [9.0, 8.7]
    assert [h.evidence for h in finalists(found, 4)] == [9.0]


def test_three_forms_of_a_single_effect_are_carried_over():
    """Fibres along x, fourth in the search, came to the true ones by the full-order model (2301/040)."""
    found = [fitted(9.0 - i, f"a ({axis})") for i, axis in enumerate("xyzw")]
    both = [fitted(9.5, "a (x)", "b"), fitted(8.0, "a (y)", "b")]
    assert finalists([*found, *both], 4, forms=3) == [both[0], *found[:3]]


def test_a_form_that_came_to_nothing_stands_for_no_other():
    """Fibres of no strength, one way, had kept out those that were there, another way (2301/040)."""
    none, found = fitted(9.0, "a (x)", slight=True), [fitted(8.5, "a (y)"), fitted(8.0, "a (z)")]
    assert finalists([none, *found], 4, tied=1.0) == found
    assert finalists([none, fitted(5.0)], 4) == [none]


def test_partners_that_add_nothing_do_not_keep_out_effects_alone():
    """Pairs less likely than one of the two alone, before effects that were further off in the search (2301/040)."""
    alone, pair, weaker = fitted(8.0, "a"), fitted(7.0, "a", "b"), fitted(5.0, "c")
    also = fitted(4.0, "d")
    assert finalists([fitted(9.0), pair, alone, weaker, also], 3) == [alone, weaker, also]


def test_full_order_fits_go_on_as_long_as_they_help(monkeypatch):
    """Two rounds of a load's fit leave it behind a slip of the clock, which is quickly fitted."""
    seen = {"load": [-40.0, -20.0, -8.0, -5.0, -4.5, 0.0], "clock": [-9.0, -8.9, 0.0]}

    def fit(name):
        return SimpleNamespace(effects=(name,), motion=object(), seen=seen[name].pop(0), label=name)

    monkeypatch.setattr(full_order, "confirmed", lambda base, errors, found: found)
    monkeypatch.setattr(full_order, "improved", lambda base, errors, found, options: fit(found.label))
    monkeypatch.setattr(full_order, "judged", lambda base, errors, found: sorted(found, key=lambda h: -h.seen))
    plain = SimpleNamespace(effects=(), motion=object(), seen=-99.0, label="base model")
    monkeypatch.setattr(full_order, "base_hypothesis", lambda base, errors: plain)
    base = SimpleNamespace(model=SimpleNamespace(cost=Cost()), situation=SimpleNamespace(clamped=True))
    inexact = SimpleNamespace(exact=None)
    found = full_order.decided(
        base, None, inexact, [fit("load"), fit("clock")], options=GapOptions(), report=lambda text: None
    )
    assert {h.label: h.seen for h in found} == {"base model": -99.0, "load": -4.5, "clock": -8.9}


@pytest.mark.wrong_types
def test_fits_are_corrected_at_their_own_values_and_fitted_on_the_base_model_too(monkeypatch):
    """But for those that are far behind: the base model alone is corrected in any case."""

    def fit(label, evidence, seen=-9.0, motion=None):
        effects = () if label.endswith("base") else (label,)
        moved = motion or object()
        return SimpleNamespace(label=label, effects=effects, motion=moved, seen=seen, evidence=evidence)

    exact, improved = [], []

    def corrected(base, errors, numerics, found):
        exact.append(found.label)
        return fit(f"exact {found.label}", found.evidence, found.seen, found.motion)

    def better(base, errors, found, options):
        improved.append(found.label)
        return fit(f"better {found.label}", found.evidence, -1.0) if found.seen < -1 else None

    monkeypatch.setattr(full_order, "confirmed", lambda base, errors, found: found)
    monkeypatch.setattr(full_order, "with_own_correction", corrected)
    monkeypatch.setattr(full_order, "improved", better)
    monkeypatch.setattr(full_order, "judged", lambda base, errors, found: sorted(found, key=lambda h: -h.evidence))
    monkeypatch.setattr(full_order, "base_hypothesis", lambda base, errors: fit("base", -40.0))
    base = SimpleNamespace(model=SimpleNamespace(cost=Cost()), situation=SimpleNamespace(clamped=False))
    fits = [fit("a spin", 0.0), fit("a tilt", -30.0), fit("a drag", -20.0)]
    numerics = SimpleNamespace(exact="fine")
    found = full_order.decided(base, None, numerics, fits, options=GapOptions(), report=lambda text: None)
    assert exact[:3] == ["base", "a spin", "a drag"] and "exact base" in improved
    assert {h.label for h in found if h.evidence == -30.0} == {"a tilt"} and "a tilt" not in improved
    assert {h.label for h in found if h.evidence == 0.0} == {"exact better exact a spin"}


def test_what_is_left_of_a_fit_is_screened_with_the_reduced_model_made_anew_there(monkeypatch):
    """Of a spin that is far from what is stated, the base fit's difference of the models hid a damping beside it."""
    stem = SimpleNamespace(effects=("spin",), motion="reduced", left_to_explain=20.0, divisor=2.0, label="spin")
    full = SimpleNamespace(effects=("spin",), values="values", errors="errors", tangents="tangents")
    point = SimpleNamespace(model="reduced like the full-order one there", motion="of it")

    def at(base, errors, model, values, deviations, motion, tangents):
        assert (model, values, motion) == (point.model, "values", point.motion)
        return SimpleNamespace(tempered=lambda divisor: SimpleNamespace(effects=("spin",), motion=motion, left=divisor))

    monkeypatch.setattr(rounds, "confirmed", lambda base, errors, found: full)
    monkeypatch.setattr(rounds, "improved", lambda base, errors, here, options: None)
    monkeypatch.setattr(rounds, "continued", lambda base, here: here)
    monkeypatch.setattr(rounds, "as_reduced", lambda base: point)
    monkeypatch.setattr(rounds, "hypothesis_at", at)
    free = SimpleNamespace(model=SimpleNamespace(cost=Cost()), situation=SimpleNamespace(clamped=False))
    search = state.EffectSearch(free, free, None, GapOptions(), lambda text: None, found=[stem])
    found = rounds._in_full(search, stem)
    assert found.motion == "of it" and found.left == 2.0 and search.found == [found]

    def fails(*arguments):
        raise ConvergenceError("at step 3")

    monkeypatch.setattr(rounds, "confirmed", fails)
    assert rounds._in_full(search, stem) is stem and search.found == [found]


def test_a_further_effect_is_looked_for_where_something_is_left_and_there_is_room_and_time():
    cost = Cost()
    base = SimpleNamespace(model=SimpleNamespace(cost=cost), situation=SimpleNamespace(clamped=False))
    search = state.EffectSearch(base, base, None, GapOptions(most_effects=2), lambda text: None)

    def one(left, *effects, fitted=2.0, selecting=2.0):
        return SimpleNamespace(effects=effects, left_to_explain=left, fitted=fitted, selecting=selecting)

    assert search.wanting(one(20.0, "spin"))
    assert search.wanting(one(0.5, "spin", fitted=14.0))  # smooth, and wide open
    assert search.wanting(one(0.5, "spin", selecting=14.0))  # opens later
    search.base = SimpleNamespace(model=base.model, situation=SimpleNamespace(clamped=True))  # it is all the same
    assert search.wanting(one(0.5, "spin", fitted=14.0)) and search.wanting(one(0.5, "spin", selecting=14.0))
    assert not search.wanting(one(0.5, "spin"))
    assert not search.wanting(one(20.0, "spin", "wind"))
    cost.spent, cost.limit = 2.0, 1.0
    assert not search.wanting(one(20.0, "spin"))


def test_a_search_that_the_clock_ends_says_whether_all_single_effects_were_tried(screening, monkeypatch):
    def searched(clock):
        """The clock strikes after so many fits."""
        fits = []
        cost = Cost(deadline=10.0)
        model = SimpleNamespace(cost=cost)
        search = state.EffectSearch(None, SimpleNamespace(model=model), None, GapOptions(), lambda text: None)

        def fit(base, errors, chosen, options, *, starts):
            fits.append(chosen)
            if len(fits) == clock:
                cost.begun = -1e9
            return SimpleNamespace(positions=np.zeros(1))

        monkeypatch.setattr(state, "fit_effects", fit)
        search.found.append(None)
        rounds.alone(search, screening.ranked)
        assert len(fits) == min(clock, 3)
        return cost

    assert searched(1).hurried and searched(2).hurried
    assert not searched(3).hurried  # the search goes no further, but has seen what the recording asks for
    assert not searched(4).hurried


@pytest.mark.wrong_types
@pytest.mark.parametrize(
    ("alone", "ahead", "spent", "fitted"),
    [
        (-41.0, -9.0, 5.0, ["attached_mass", "time_scale"]),  # the load alone had stopped on its way
        (-23.0, -9.0, 5.0, ["time_scale"]),  # it leaves hardly more than both
        # the search has cost what it may: for this there is something left
        (-41.0, -9.0, 1e4, ["attached_mass", "time_scale"]),
        (-41.0, 3.0, 5.0, ["attached_mass", "time_scale"]),  # nothing is far ahead of both
        (-41.0, 9.0, 5.0, []),  # the clock alone is
    ],
)
def test_the_best_combination_is_fitted_without_each_of_its_effects(monkeypatch, alone, ahead, spent, fitted):
    clock, load = effect("time_scale"), effect("attached_mass")

    def fit(evidence, seen, *effects):
        return SimpleNamespace(
            effects=effects, evidence=evidence, seen=seen, values=np.arange(4.0), positions=np.zeros(1),
            tangents=np.zeros((1, 4, 1, 3)), model=Fitted(effects, slices=(slice(1, 2), slice(2, 4))),
        )  # fmt: skip

    tried = []

    def refit(base, errors, model, values, tangents, options):
        tried.append(model.effects[0].name)
        assert list(values) == ([0.0, 2.0, 3.0] if model.effects[0] is load else [0.0, 1.0])
        assert tangents.shape[1] == len(values)
        return fit(-50.0, -20.0, *model.effects)

    monkeypatch.setattr(rounds, "refit", refit)
    monkeypatch.setattr(state, "judged", lambda base, errors, found: sorted(found, key=lambda h: -h.evidence))
    cost = Cost(spent=spent, limit=100.0)
    base = SimpleNamespace(model=SimpleNamespace(cost=cost))
    search = state.EffectSearch(base, base, None, GapOptions(), lambda text: None)
    search.found += [fit(0.0, -20.0, clock, load), fit(ahead, -29.0, clock), fit(-80.0, alone, load)]
    rounds.leave_out(search)
    assert tried == fitted


@dataclass(frozen=True)
class Fitted:
    """As much of a model as leaving out needs."""

    effects: tuple[SimpleNamespace, ...]
    slices: tuple[slice, ...]
