"""A fit carried over to the full-order model is fitted on there, and kept only if that is better."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from physconvex.gap import DEFAULT_EFFECTS, GapOptions
from physconvex.gap.base.cost import Cost
from physconvex.gap.search import full_order as mapping

pytestmark = pytest.mark.wrong_types


@dataclass(frozen=True)
class Model:
    """As much of a model as a fit needs that is carried over; `made` gathers where the full-order one was run."""

    made: list
    effects: tuple = ()
    frames: int = 9

    def parameters(self, values):
        return [SimpleNamespace(step=1.0)]

    def motion(self, values):
        self.made.append(float(values[0]))
        return SimpleNamespace(first=lambda count: count)

    def linearise(self, values, motion):
        assert motion == self.frames == 5
        return motion, f"taken at {values[0]:g}"


@pytest.fixture
def runs(monkeypatch):
    """Stand-ins: fits go one to the right each time, what the full-order model leaves there is given."""
    made, left, searched = [], {}, []

    def at(base, errors, model, values, deviations, motion, tangents):
        fitted, seen = left[values[0]]
        return SimpleNamespace(
            model=model, values=values, errors=deviations, motion=motion, tangents=tangents, fitted=fitted, seen=seen
        )

    def refit(base, errors, model, values, tangents, options):
        assert tangents == "taken at 0"
        searched.append(model)
        return SimpleNamespace(values=values + 1, errors=np.zeros(1), tangents=tangents)

    full, cheap = Model(made), Model([])
    monkeypatch.setattr(mapping, "hypothesis_at", at)
    monkeypatch.setattr(mapping, "reduced_like", lambda full, motion, values: (cheap, motion))
    monkeypatch.setattr(mapping, "refit", refit)
    start = SimpleNamespace(
        model=full, values=np.zeros(1), errors=np.zeros(1), motion=SimpleNamespace(first=lambda count: count),
        tangents=None, fitted=5.0, seen=-50.0,
    )  # fmt: skip
    return SimpleNamespace(made=made, left=left, start=start, cost=Cost(), searched=searched, cheap=cheap)


def improved(runs):
    base = SimpleNamespace(model=SimpleNamespace(cost=runs.cost), split=SimpleNamespace(end=5))
    return mapping.improved(base, None, runs.start, GapOptions())


def test_the_best_full_order_run_counts(runs):
    runs.left |= {1.0: (2.0, -20.0), 2.0: (2.5, -25.0)}
    found = improved(runs)
    assert found.seen == -20.0 and runs.made == [1.0, 2.0]


def test_what_a_struck_body_shows_counts_though_its_mean_square_is_the_flight_s(runs):
    """A yield stress (2401/045) came within .02 decades of the truth, thrown away for 1e-4 of the flight's square."""
    runs.left |= {1.0: (5.0001, -45.0), 2.0: (5.0002, -30.0)}
    assert improved(runs).seen == -30.0


def test_a_worse_one_is_left(runs):
    runs.left |= {1.0: (9.0, -90.0)}
    assert improved(runs) is None and runs.made == [1.0]


def test_what_saturates_is_searched_with_the_full_order_model(runs):
    """At .12 decades another yield stress than the full-order model's, the reduced one's flow ends."""
    runs.left |= {1.0: (2.0, -20.0), 2.0: (2.0, -20.0)}
    improved(runs)
    assert all(model is runs.cheap for model in runs.searched)
    runs.searched.clear()
    yielding = next(effect for effect in DEFAULT_EFFECTS if effect.name == "plasticity")
    runs.start.model = replace(runs.start.model, effects=(yielding,))
    improved(runs)
    assert runs.searched and all(model is runs.start.model for model in runs.searched)


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
