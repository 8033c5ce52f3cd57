"""A fit carried over to the full-order model is fitted on there, and kept only if that is better."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.gap.base.cost import Cost
from physconvex.gap.options import GapOptions
from physconvex.gap.search import mapping

pytestmark = pytest.mark.wrong_types


@pytest.fixture
def runs(monkeypatch):
    """Stand-ins: the reduced model's fits go one to the right each time, the full-order model's misfit is given."""
    made, misfits = [], {}

    def at(base, errors, model, values, deviations, motion, tangents):
        return SimpleNamespace(
            model=model, values=values, errors=deviations, motion=motion, tangents=tangents, fitted=misfits[values[0]]
        )

    def motion(values):
        made.append(float(values[0]))
        return object()

    model = SimpleNamespace(parameters=lambda values: [SimpleNamespace(step=1.0)], motion=motion)
    monkeypatch.setattr(mapping, "hypothesis_at", at)
    monkeypatch.setattr(mapping, "reduced_like", lambda full, motion, values: (None, None))
    monkeypatch.setattr(
        mapping, "refit", lambda *a: SimpleNamespace(values=a[3] + 1, errors=np.zeros(1), tangents=None)
    )
    start = SimpleNamespace(
        model=model, values=np.zeros(1), errors=np.zeros(1), motion=object(), tangents=None, fitted=5.0
    )
    return SimpleNamespace(made=made, misfits=misfits, start=start, cost=Cost())


def improved(runs):
    base = SimpleNamespace(model=SimpleNamespace(cost=runs.cost))
    return mapping.improved(base, None, runs.start, GapOptions())


def test_the_best_full_order_run_counts(runs):
    runs.misfits |= {1.0: 2.0, 2.0: 2.5}
    found = improved(runs)
    assert found.fitted == 2.0 and runs.made == [1.0, 2.0]


def test_a_worse_one_is_left(runs):
    runs.misfits |= {1.0: 9.0}
    assert improved(runs) is None and runs.made == [1.0]


def test_nothing_is_run_once_the_costs_are_spent(runs):
    runs.cost.spent = 2.0
    runs.cost.allow(-1.0, 1.0)
    assert improved(runs) is None and not runs.made


@dataclass(frozen=True)
class Cheap:
    """A model as far as its effects can be left out."""

    effects: tuple = ("heterogeneity",)


def test_a_held_body_swings_on_the_finer_mesh_as_it_did_on_the_coarser(monkeypatch):
    """The two differ by .02 decades at the base fit; with an inclusion by .07 more, which E takes up."""
    held = SimpleNamespace(clamped=True)
    full = SimpleNamespace(base=(mapping.MODULUS, "poisson_ratio"), situation=held, mesh=None, uneven=True)
    base = SimpleNamespace(situation=held, model=SimpleNamespace(uneven=False), fit=SimpleNamespace(values=np.ones(2)))
    found = SimpleNamespace(model=Cheap(), values=np.array([5.0, 0.4, 0.3]))
    monkeypatch.setattr(mapping, "searches_itself", lambda model: False)
    monkeypatch.setattr(mapping, "decades_between", lambda one, other, values: 0.09 if other.uneven else 0.02)
    values = mapping._in_step(base, full, found)
    assert values == pytest.approx([5.07, 0.4, 0.3]) and found.values[0] == 5.0
    held.clamped = False
    assert mapping._in_step(base, full, found) is found.values
