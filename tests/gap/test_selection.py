"""Which effects are fitted, how far, and which of them the full-order model decides between."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex import ConvergenceError
from physconvex.fem import Scene
from physconvex.gap import DEFAULT_EFFECTS, Effect, Score
from physconvex.gap.base.cost import Cost
from physconvex.gap.errors.numerical_differences import Numerics, exact_model
from physconvex.gap.errors.screening import Screened, Screening, best_pairs, screen
from physconvex.gap.search.full_order import confirmed, decided, fitted_while_it_helps
from physconvex.gap.search.hypothesis import finalists
from physconvex.gap.search.rounds import _in_full, alone, from_elsewhere, leave_out, other_places, without_each
from tests.gap.fits import OPTIONS, effect, fit_at, search_on, told


def entry(one, row, left):
    one = effect(one) if isinstance(one, str) else one
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
    return Screening(ranked, (), left)


def test_a_pair_that_helps_only_together_comes_first(screening):
    pair = best_pairs(screening, 1)[0]
    assert {pair.first.effect.name, pair.second.effect.name} == {"damping", "friction"}
    lack_of_fit = screening.left @ screening.left
    assert pair.statistic == pytest.approx(lack_of_fit, rel=1e-6)
    assert pair.statistic - max(one.score.statistic for one in (pair.first, pair.second)) > 0.3 * lack_of_fit
    doses = {p.effect.name: p.doses[0] for p in (pair.first, pair.second)}
    assert doses["friction"] == pytest.approx(0.1 * 10 / 1.3, rel=1e-4)


def test_pairs_are_named_once(screening):
    names = [frozenset((p.first.effect.name, p.second.effect.name)) for p in best_pairs(screening, 9)]
    assert len(names) == len(set(names)) <= 3


def test_what_is_somewhere_in_a_struck_body_is_fitted_from_several_places(dropped_box, rng):
    """From the one place that screened best, a stiff core (2301/034) stopped behind an air drag that does nothing."""
    known = [e for e in DEFAULT_EFFECTS if e.name in ("heterogeneity", "friction")]
    ranked = tuple(entry(one, rng.normal(size=60), np.ones(60)) for one in known)
    screening, tried = Screening(ranked, (), np.ones(60)), [ranked[0], ranked[-1]]
    places = other_places(screening, tried)
    assert len(places) == 4 and not any(place in tried for place in places)
    assert all(place.effect.variant.startswith("inclusion") for place in places)
    search = search_on(dropped_box)
    search.full = search.base = replace(search.base, situation=replace(search.base.situation, clamped=True))
    from_elsewhere(search, screening, tried)
    assert len(search.found) == 1  # of a held body none


def test_other_places_of_an_effect_are_fitted(dropped_box):
    place, *others = [e for e in DEFAULT_EFFECTS if e.name == "heterogeneity"][:2]
    search = search_on(dropped_box)
    numerics = no_differences(search)
    screening = screen(search.base, search.errors, numerics, [place, *others], search.report)
    tried = [one for one in screening.ranked if one.effect is place]
    from_elsewhere(search, screening, tried)
    assert [h.label for h in search.found] == ["base model", others[0].label]


@pytest.mark.parametrize(("clamped", "points", "placed"), [(False, 20, True), (False, 1, False), (True, 20, False)])
def test_places_are_tried_where_the_recording_tells_how_a_struck_body_deforms(dropped_box, clamped, points, placed):
    """The middle of a rolling ball tells no direction of fibres: their fits took what a search may cost. What bends as
    a whole tells the place.
    """  # fmt: skip
    search, motion = search_on(dropped_box), dropped_box.motion
    few = replace(motion, positions=motion.positions[:, :points], velocities=motion.velocities[:, :points], steps=None)
    model = replace(search.base.model, correction=None)
    situation = replace(search.base.situation, clamped=clamped)
    search.base = replace(search.base, model=model, motion=few, situation=situation)
    assert search.placed == placed


def test_the_best_single_effects_are_carried_over(dropped_box):
    rows = [(0, ()), (9, ("a", "b")), (8, ("a", "c")), (5, ("a",)), (4, ("a",)), (3, ("c",))]
    found = [told(dropped_box, *labels, evidence=evidence) for evidence, labels in rows]
    chosen = finalists(found, 2)
    assert [h.names for h in chosen] == [("a", "b"), ("a", "c"), ("a",), ("c",)] and chosen[2].evidence == 5


def test_a_form_that_is_as_likely_is_carried_over(dropped_box):
    rows = [(9.0, ("a (x)", "b")), (8.7, ("a (y)", "b")), (8.6, ("a (y)", "b")), (6.0, ("a (z)", "b"))]
    found = [told(dropped_box, *labels, evidence=evidence) for evidence, labels in rows]
    assert [h.evidence for h in finalists(found, 4, tied=1.0)] == [9.0, 8.7]
    assert [h.evidence for h in finalists(found, 4)] == [9.0]


def test_three_forms_of_a_single_effect_are_carried_over(dropped_box):
    """Fibres along x, fourth in the search, came to the true ones by the full-order model (2301/040)."""
    found = [told(dropped_box, f"a ({axis})", evidence=9.0 - i) for i, axis in enumerate("xyzw")]
    both = [told(dropped_box, "a (x)", "b", evidence=9.5), told(dropped_box, "a (y)", "b", evidence=8.0)]
    assert finalists([*found, *both], 4, forms=3) == [both[0], *found[:3]]


def test_a_form_that_came_to_nothing_stands_for_no_other(dropped_box):
    """Fibres of no strength, one way, had kept out those that were there, another way (2301/040)."""
    none = told(dropped_box, "a (x)", evidence=9.0, slight=True)
    found = [told(dropped_box, "a (y)", evidence=8.5), told(dropped_box, "a (z)", evidence=8.0)]
    assert finalists([none, *found], 4, tied=1.0) == found
    assert finalists([none, told(dropped_box, evidence=5.0)], 4) == [none]


def test_partners_that_add_nothing_do_not_keep_out_effects_alone(dropped_box):
    """Pairs less likely than one of the two alone, before effects that were further off in the search (2301/040)."""
    single, weaker = told(dropped_box, "a", evidence=8.0), told(dropped_box, "c", evidence=5.0)
    also, pair = told(dropped_box, "d", evidence=4.0), told(dropped_box, "a", "b", evidence=7.0)
    assert finalists([told(dropped_box, evidence=9.0), pair, single, weaker, also], 3) == [single, weaker, also]


def test_full_order_fits_go_on_as_long_as_they_help(dropped_box):
    """Two rounds of a load's fit leave it behind a slip of the clock, which is quickly fitted."""
    seen = {"load": [-40.0, -20.0, -8.0, -5.0, -4.5, 0.0], "clock": [-9.0, -8.9, 0.0]}

    def next_fit(name):
        return told(dropped_box, name, seen=seen[name].pop(0))

    plain = told(dropped_box, seen=-99.0)
    found = fitted_while_it_helps(
        [plain, next_fit("load"), next_fit("clock")],
        {id(plain.motion)},
        lambda fit: next_fit(fit.label),
        lambda fits: sorted(fits, key=lambda fit: -fit.seen),
    )
    assert {h.label: h.seen for h in found} == {"base model": -99.0, "load": -4.5, "clock": -8.9}


def test_a_fit_that_cannot_be_made_better_is_tried_once(dropped_box):
    tried = []
    fits = [told(dropped_box, "a"), told(dropped_box, "b")]
    found = fitted_while_it_helps(fits, set(), lambda fit: tried.append(fit.label), lambda fits: list(fits))  # type: ignore[func-returns-value]
    assert found == fits and tried == ["a", "b"]


def no_differences(search):
    still = np.zeros_like(search.full.motion.positions)
    return Numerics(still, still, still, still, still)


def test_the_full_order_model_fits_on_what_the_search_found(dropped_box):
    texts = []
    search = search_on(dropped_box)
    fits = [fit_at(search, [effect("initial_spin")], [0.0, 0.05, 0.0]), fit_at(search, [effect("damping")], [1e-3])]
    found = decided(search.full, search.errors, no_differences(search), fits, options=OPTIONS, report=texts.append)
    assert [h.label for h in found] == ["base model", "initial_spin", "damping"]
    for fit, better in zip(fits, found[1:], strict=True):
        assert not better.model.reduced and better.seen >= confirmed(search.full, search.errors, fit).seen
        assert f"full-order fit: {fit.label}" in texts
    assert any(
        better.seen > confirmed(search.full, search.errors, fit).seen
        for fit, better in zip(fits, found[1:], strict=True)
    )
    assert "full-order fit: base model" not in texts  # it is fitted already


def test_fits_are_corrected_at_their_own_values_and_fitted_on_the_base_model_too(dropped_box):
    """But for those that are far behind: the base model alone is corrected in any case."""
    texts = []
    search = search_on(dropped_box, variance=1e2)
    near, far = fit_at(search, [effect("damping")], [1e-4]), fit_at(search, [effect("gravity_tilt")], [20.0, 0.0])
    mesh, still = search.full.model.twin.mesh, np.zeros_like(search.full.motion.positions)
    numerics = replace(no_differences(search), finest=still, exact=(mesh, still))
    found = decided(search.full, search.errors, numerics, [near, far], options=OPTIONS, report=texts.append)
    by_label = {h.label: h for h in found}
    assert by_label["gravity_tilt"].model.correction is None
    assert "full-order fit: gravity_tilt" not in texts and "full-order fit: base model" in texts
    for label in ("base model", "damping"):
        fit = by_label[label]
        exact = exact_model(fit.model, mesh).positions(fit.values)
        np.testing.assert_allclose(fit.positions, exact, atol=1e-9)
        own = replace(fit.model, correction=None).positions(fit.values)
        assert np.abs(fit.positions - own).max() > 1e-5  # finer steps change something


def test_what_is_left_of_a_fit_is_screened_with_the_reduced_model_made_anew_there(dropped_box):
    """Of a spin that is far from what is stated, the base fit's difference of the models hid a damping beside it."""
    search = search_on(dropped_box)
    stem = fit_at(search, [effect("initial_spin")], [0.0, 1.0, 0.0])
    search.found.append(stem)
    found = _in_full(search, stem)
    assert search.found[1:] == [found] and found.model.reduced
    full = replace(search.full.model, effects=stem.effects)
    exact = full.positions(found.values)
    np.testing.assert_allclose(found.positions, exact, atol=1e-9)
    before = replace(stem.model).positions(found.values)  # with the base fit's difference of the models
    assert np.abs(before - exact).max() > 1e-4


def test_a_fit_that_the_full_order_model_cannot_run_stays_as_it_is(dropped_box):
    def reduced_alone(scene, doses):
        if isinstance(scene, Scene):
            raise ConvergenceError("at step 3")
        return scene

    search = search_on(dropped_box)
    spin = effect("initial_spin")
    stem = fit_at(search, [Effect("a", "external", spin.doses[:1], scene=reduced_alone)], [0.1])
    search.found.append(stem)
    assert _in_full(search, stem) is stem and search.found[1:] == [stem]


def test_a_further_effect_is_looked_for_where_something_is_left_and_there_is_room_and_time(dropped_box):
    cost = Cost()
    search = search_on(dropped_box, cost=cost, options=OPTIONS.replace(most_effects=2))

    def one(left, *labels, **squares):
        return told(dropped_box, *labels, left=left, **squares)

    assert one(20.0, "spin").left_to_explain == pytest.approx(20.0)
    assert search.wanting(one(20.0, "spin"))
    assert search.wanting(one(0.5, "spin", fitted=14.0))  # smooth, and wide open
    assert search.wanting(one(0.5, "spin", selecting=14.0))  # opens later
    held = replace(search.base.situation, clamped=True)
    search.base = replace(search.base, situation=held)  # it is all the same
    assert search.wanting(one(0.5, "spin", fitted=14.0)) and search.wanting(one(0.5, "spin", selecting=14.0))
    assert not search.wanting(one(0.5, "spin"))
    assert not search.wanting(one(20.0, "spin", "wind"))
    cost.limit = cost.spent - 1.0
    assert not search.wanting(one(20.0, "spin"))


@pytest.mark.parametrize(("clock", "hurried"), [(1, True), (2, True), (3, False), (4, False)])
def test_a_search_that_the_clock_ends_says_whether_all_single_effects_were_tried(dropped_box, clock, hurried):
    """The clock strikes during a fit; after the third, the search has seen what the recording asks for."""
    cost, begun = Cost(deadline=1e6), []

    def report(text):
        begun.append(text)
        if len(begun) == clock:
            cost.begun = -1e9

    search = search_on(dropped_box, cost=cost)
    names = ("friction", "damping", "restitution")
    tried = [e for e in DEFAULT_EFFECTS if e.name in names and not e.variant]
    screening = screen(search.base, search.errors, no_differences(search), tried, search.report)
    search.report = report
    search.found.append(search.found[0])  # beyond the first fit, which is always begun
    alone(search, screening.ranked)
    assert len([text for text in begun if "failed" not in text]) == min(clock, 3)
    assert cost.hurried == hurried


@pytest.mark.parametrize(
    ("alone", "fitted"),
    [
        (-41.0, ["load", "clock"]),  # the load alone had stopped on its way
        (-23.0, ["clock"]),  # it leaves hardly more than both
    ],
)
def test_a_combination_is_fitted_without_each_of_its_effects(dropped_box, alone, fitted):
    both = told(dropped_box, "clock", "load", seen=-20.0)
    clock, load = both.effects
    count = len(dropped_box.fit.values)
    both = replace(both, tangents=np.arange(count + 2.0)[None, :, None, None])
    single = replace(told(dropped_box, "clock", seen=-29.0), effects=(clock,))
    other = replace(told(dropped_box, "load", seen=alone), effects=(load,))
    found = list(without_each(both, [both, single, other]))
    assert [model.effects[0].name for model, _, _ in found] == fitted
    for model, values, tangents in found:
        own = count if model.effects == (clock,) else count + 1
        assert list(values) == [*both.values[:count], both.values[own]]
        assert list(tangents[0, :, 0, 0]) == [*range(count), own]


@pytest.mark.parametrize(
    ("ahead", "spent", "fitted"),
    [
        (-9.0, 0.0, True),
        (-9.0, 1e4, True),  # the search has cost what it may: for this there is something left
        (3.0, 0.0, True),  # nothing is far ahead of both
        (9.0, 0.0, False),  # the clock alone is
    ],
)
def test_the_best_combination_is_fitted_without_its_effects_unless_something_is_far_ahead(
    dropped_box, ahead, spent, fitted
):
    texts = []
    search = search_on(dropped_box, report=texts.append)
    cost = search.base.model.cost
    both, single = told(dropped_box, "clock", "load"), told(dropped_box, "clock")
    search.found = [told(dropped_box, seen=-500.0), both, single]
    ranked = {h.label: h for h in search.ranked}  # with the evidence that is reckoned with
    lift = ranked["clock + load"].evidence - ranked["clock"].evidence + ahead
    search.found[2] = replace(
        single, likelihood=single.likelihood + lift * np.where(single.likelihood, ranked["clock"].divisor, 0)
    )
    cost.limit, cost.spent = cost.spent + 1.0, cost.spent + spent
    leave_out(search)
    assert ("fit: load" in texts) == fitted
    assert cost.limit >= cost.spent or not fitted
