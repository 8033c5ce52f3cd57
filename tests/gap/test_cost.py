"""The search ends by what its runs have cost, counted and not timed; the clock stands behind."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex import ConvergenceError
from physconvex.dynamics import SolveStatistics
from physconvex.fem import Scene
from physconvex.gap import Effect
from physconvex.gap.base.cost import Cost, OutOfBudget, newton_step
from physconvex.gap.base.model import MODULUS
from physconvex.gap.effects.scenes import with_material
from physconvex.gap.errors.numerical_differences import Numerics
from physconvex.gap.search.full_order import decided
from physconvex.materials import StandardLinearSolid
from tests.gap.fits import OPTIONS, effect, fit_at, search_on, with_cost


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


@pytest.mark.parametrize(("spent", "begun"), [(4.0, 1), (6.0, 0)])
def test_no_fit_is_begun_beyond_the_limit(dropped_box, spent, begun):
    fits, search = [], search_on(dropped_box)
    cost = search.base.model.cost
    search.found.append(search.found[0])  # the first fit, which is always made
    cost.spent = 0.0
    cost.allow(5.0, 1.0)
    cost.spent = spent

    def run():
        fits.append(search.found[0])
        return fits[-1]

    assert (search.attempt("a fit", run) is None) == (not begun) and len(fits) == len(search.found) - 2 == begun


def test_a_fit_in_progress_ends_where_it_is(dropped_box):
    cost, costs = Cost(), []
    model = replace(with_cost(dropped_box, cost).model, frames=3, reduced=True)
    values = dropped_box.fit.values
    motion = model.motion(values)
    secant = model.secant(values, *model.linearise(values, motion))
    other = values + [0.1 if name == MODULUS else 0.0 for name in model.names]

    def spent_on(place):
        before = cost.spent
        secant.linearise(place)
        return cost.spent - before

    with cost.at_most(5.0):
        costs.append(spent_on(other))
        cost.spent += 6.0
        costs.append(spent_on(other))  # known already: costs nothing
        with pytest.raises(OutOfBudget):
            secant.linearise(values)
    costs.append(spent_on(values))  # what may be spent on one fit does not bind the next
    assert costs[0] > 0 and costs[1] == 0 and costs[2] > 0


def test_the_clock_ends_what_the_count_does_not():
    late, early = Cost(deadline=10.0, begun=-1e9), Cost(deadline=1e9)
    for cost in (late, early):
        cost.allow(np.inf, 0.5)
    assert late.over and late.cut and not early.over and not early.cut


@pytest.mark.parametrize("can_run", [True, False])
def test_nothing_that_was_found_is_lost_when_time_is_up(dropped_box, can_run):
    """The first finalist is run by the full-order model all the same; where that fails, the fit counts as it is."""

    def reduced_alone(scene, doses):
        if isinstance(scene, Scene) and not can_run:
            raise ConvergenceError("no")
        return scene

    search = search_on(dropped_box)
    doses = effect("initial_spin").doses[:1]
    fits = [fit_at(search, [Effect(name, "external", doses, scene=reduced_alone)], [0.1]) for name in "ab"]
    full = with_cost(search.full, Cost(deadline=10.0, begun=-1e9))
    still = np.zeros_like(full.motion.positions)
    numerics = Numerics(still, still, still, still, still)
    found = decided(full, search.errors, numerics, fits, options=OPTIONS, report=lambda _: None)
    assert [h.label for h in found] == ["base model", "a"] and full.model.cost.cut == can_run
    assert found[1].model.reduced != can_run and (found[1] is fits[0]) != can_run
