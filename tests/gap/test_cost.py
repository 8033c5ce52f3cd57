"""The search ends by what its runs have cost, counted and not timed; the clock stands behind."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.dynamics import SolveStatistics
from physconvex.gap import GapOptions
from physconvex.gap.base.cost import Cost, OutOfBudget, newton_step
from physconvex.gap.effects.scenes import with_material
from physconvex.gap.search import full_order as decision
from physconvex.gap.search.search_state import EffectSearch
from physconvex.identify import SecantModel
from physconvex.materials import StandardLinearSolid


def test_cost_follows_newton_steps_and_nodes(falling, falling_reduced):
    full, reduced = Cost(), Cost()
    for cost, scene, nodes in ((full, falling, 1000), (reduced, falling_reduced, None)):
        cost.add(scene, nodes, SolveStatistics(newton_iterations=300))
    assert full.spent == pytest.approx(1.5) and full.spent > 10 * reduced.spent
    before = full.spent
    full.add_failed(falling, 1000, 100)
    assert full.spent > 2 * before  # a run that was given up is not for nothing


def test_what_flows_or_is_damped_costs_more(falling, falling_reduced):
    for scene, nodes, most in ((falling, 200, 4.0), (falling_reduced, None, 4.0)):
        plain = newton_step(scene, nodes)
        damped = newton_step(replace(scene, damping_time=1e-3), nodes)
        flowing = newton_step(with_material(scene, flow=StandardLinearSolid(0.3, 0.1)), nodes)
        assert plain < damped < flowing and flowing > most * plain


@pytest.mark.wrong_types
@pytest.mark.parametrize(("spent", "begun"), [(4.0, 1), (6.0, 0)])
def test_no_fit_is_begun_beyond_the_limit(spent, begun):
    cost, fits = Cost(), []
    cost.allow(5.0, 1.0)
    cost.spent = spent
    base = SimpleNamespace(model=SimpleNamespace(cost=cost))
    search = EffectSearch(base, base, None, GapOptions(), lambda _: None)
    search.found += [SimpleNamespace(), SimpleNamespace()]  # the base model, and the first fit, which is always made

    def run():
        fits.append(1)
        return SimpleNamespace(positions=np.zeros(3))

    assert (search.attempt("a fit", run) is None) == (not begun) and len(fits) == len(search.found) - 2 == begun


@pytest.mark.wrong_types
def test_a_fit_in_progress_ends_where_it_is():
    cost, runs = Cost(), []

    def positions(values):
        runs.append(values)
        return np.zeros((2, 1, 3))

    model = SimpleNamespace(positions=positions)
    secant = SecantModel(
        model, np.zeros(1), np.zeros((2, 1, 3)), np.ones((2, 1, 1, 3)), scales=np.ones(1), check=cost.check
    )
    with cost.at_most(5.0):
        secant.linearise(np.ones(1))
        cost.spent = 6.0
        secant.linearise(np.ones(1))  # known already: costs nothing
        with pytest.raises(OutOfBudget):
            secant.linearise(np.full(1, 2.0))
    secant.linearise(np.full(1, 2.0))  # what may be spent on one fit does not bind the next
    assert len(runs) == 2


def test_the_clock_ends_what_the_count_does_not():
    late, early = Cost(deadline=10.0, begun=-1e9), Cost(deadline=1e9)
    for cost in (late, early):
        cost.allow(np.inf, 0.5)
    assert late.over and late.cut and not early.over and not early.cut


@pytest.mark.wrong_types
@pytest.mark.parametrize(("full_order", "expected"), [(True, ["base", "a by the full model"]), (False, ["base", "a"])])
def test_nothing_that_was_found_is_lost_when_time_is_up(monkeypatch, full_order, expected):
    """The first finalist is run by the full-order model all the same; where that fails, the fit counts as it is."""
    from physconvex import ConvergenceError

    def hypothesis(label):
        return SimpleNamespace(label=label, effects=() if label == "base" else (1,), motion=object())

    def confirmed(base, errors, found):
        if not full_order:
            raise ConvergenceError("no")
        return hypothesis(f"{found.label} by the full model")

    monkeypatch.setattr(decision, "confirmed", confirmed)
    monkeypatch.setattr(decision, "base_hypothesis", lambda *_: hypothesis("base"))
    monkeypatch.setattr(decision, "judged", lambda base, errors, hypotheses: list(hypotheses))
    monkeypatch.setattr(decision, "improved", lambda *_: None)
    cost = Cost(deadline=10.0, begun=-1e9)
    base = SimpleNamespace(model=SimpleNamespace(cost=cost), situation=SimpleNamespace(clamped=False))
    found = decision.decided(
        base,
        None,
        SimpleNamespace(exact=None),
        [hypothesis("a"), hypothesis("b")],
        options=GapOptions(),
        report=lambda _: None,
    )
    assert [h.label for h in found] == expected
