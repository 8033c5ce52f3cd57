"""The search ends by what its runs have cost, counted and not timed."""

from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.fem import SolveStatistics
from physconvex.gap.cost import Cost
from physconvex.gap.options import GapOptions
from physconvex.gap.selection import Selection


def test_cost_follows_newton_steps_and_nodes():
    full, reduced = Cost(), Cost()
    for cost, nodes in ((full, 1000), (reduced, None)):
        cost.add(SolveStatistics(newton_iterations=300), nodes)
    assert full.spent == pytest.approx(2.4) and full.spent > 10 * reduced.spent
    before = full.spent
    full.add_failed(100, 1000)
    assert full.spent > 2 * before  # a run that was given up is not for nothing


@pytest.mark.wrong_types
@pytest.mark.parametrize(("spent", "begun"), [(4.0, 1), (6.0, 0)])
def test_no_fit_is_begun_beyond_the_limit(spent, begun):
    cost, fits = Cost(), []
    cost.spent = spent
    base = SimpleNamespace(model=SimpleNamespace(cost=cost))
    search = Selection(base, None, GapOptions(), lambda _: None, 5.0)

    def run():
        fits.append(1)
        return SimpleNamespace(positions=np.zeros(3))

    assert (search.attempt("a fit", run) is None) == (not begun) and len(fits) == len(search.found) == begun
