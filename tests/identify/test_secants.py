"""Derivatives carried on by Broyden's update: a search with them ends where one with fresh derivatives does."""

import gc
import weakref
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from physconvex.capture import Capture, Floor, load_capture, save_capture
from physconvex.crew import Crew
from physconvex.errors import ConvergenceError
from physconvex.fem import TetMesh, box_mesh, refine
from physconvex.identify import (
    FitOptions,
    FullModel,
    MarkerObservations,
    RollOuts,
    TwinOptions,
    base_twin,
    default_parameter,
    fit,
    roll_out_together,
)
from physconvex.identify.secants import broyden_update

NAMES, TRUTH = ("log10_youngs_modulus", "poisson_ratio", "damping_time"), np.array([4.3, 0.35, 1e-3])
SCALES = np.array([0.2, 0.1, 2e-3])


def test_an_update_explains_the_change_and_leaves_other_directions_alone():
    rng = np.random.default_rng(0)
    slope, change = rng.normal(size=(4, 3, 5, 3)), rng.normal(size=(4, 5, 3))
    step = SCALES * np.array([1.0, -2.0, 0.5])
    updated = broyden_update(slope, step, change, SCALES)
    np.testing.assert_allclose(np.einsum("tkpi,k->tpi", updated, step), change, atol=1e-12)
    across = SCALES * np.array([2.0, 1.0, 0.0])  # at right angles, in typical steps
    np.testing.assert_allclose(*(np.einsum("tkpi,k->tpi", s, across) for s in (updated, slope)), atol=1e-12)
    np.testing.assert_array_equal(broyden_update(slope, 1e-6 * step, change, SCALES), slope)


@dataclass(frozen=True, eq=False)
class Bent:
    """A smooth model with derivatives by three further evaluations, all of which are counted."""

    points: np.ndarray
    differenced: bool = True
    made: list = field(default_factory=list)
    kept: dict = field(default_factory=dict)
    names: tuple = NAMES

    def positions(self, values):
        self.made.append("positions")
        scaled = (values - TRUTH) / SCALES
        time = np.arange(5)[:, None, None]
        bend = np.sin(0.4 * scaled[0] * time * self.points) + np.exp(0.3 * scaled[1] * self.points[:, ::-1])
        return self.points + bend + 0.2 * time * np.tanh(scaled[2]) * np.roll(self.points, 1, axis=1) ** 2

    def linearise(self, values):
        self.made.append("derivatives")
        changes = np.diag(1e-5 * SCALES)
        slopes = [(self.positions(values + c) - self.positions(values - c)) / (2 * c.sum()) for c in changes]
        self.kept[values.tobytes()] = np.stack(slopes, axis=1), True
        return self.positions(values), self.kept[values.tobytes()][0]

    def known(self, values):
        found = self.kept.get(values.tobytes())
        return None if found is None else (self.positions(values), *found)

    def followed(self, values, last):
        change = self.positions(values) - self.positions(last)
        slope = broyden_update(self.kept[last.tobytes()][0], values - last, change, SCALES)
        self.kept[values.tobytes()] = slope, False
        return self.positions(values), slope


@pytest.fixture
def bent():
    return Bent(np.random.default_rng(1).uniform(-1, 1, (12, 3)))


def searched(model, **options):
    seen = model.positions(TRUTH) + 0.01 * np.random.default_rng(2).normal(size=(5, 12, 3))
    start = [default_parameter(n).at(v) for n, v in zip(NAMES, TRUTH + SCALES * [0.8, -0.7, 0.9], strict=True)]
    model.made.clear()
    markers = MarkerObservations(model.points, seen, np.full((5, 12), 0.01))
    return fit(model, markers, start, options=options_of(options))


def options_of(options):
    return FitOptions(max_iterations=30, absolute_tolerance=1e-4, **({"secants": True} | options))


def test_a_search_with_them_ends_where_one_with_fresh_derivatives_does(bent):
    carried = searched(bent)
    count = bent.made.count("derivatives")
    fresh = searched(bent, secants=False)
    assert carried.converged and fresh.converged
    deviations = np.sqrt(np.diag(np.linalg.inv(fresh.jacobian.T @ fresh.jacobian)))
    assert (np.abs(carried.values - fresh.values) < 0.02 * deviations).all()
    assert count < bent.made.count("derivatives")


def test_the_last_derivatives_are_fresh_unless_another_search_follows(bent):
    found = searched(bent)
    _, tangents = bent.linearise(found.values)
    expected = np.moveaxis(tangents, 1, -1).reshape(-1, 3) / 0.01
    np.testing.assert_allclose(found.jacobian, expected, rtol=1e-9, atol=1e-9)
    bent.kept.clear()
    searched(bent, fresh_end=False)
    assert not list(bent.kept.values())[-1][1]


def test_the_next_search_begins_with_what_the_last_one_left(bent):
    found = searched(bent, fresh_end=False)
    bent.made.clear()
    start = [default_parameter(n).at(v) for n, v in zip(NAMES, found.values, strict=True)]
    seen = MarkerObservations(bent.points, found.positions, np.full((5, 12), 0.01))
    fit(bent, seen, start, options=options_of({"fresh_end": False}))
    assert "derivatives" not in bent.made


# -- the full model


def box(tmp_path, memory):
    mesh = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=1)
    tets = TetMesh(mesh.vertices + np.array([0, 0, 0.012]), mesh.tets)
    still = {"initial_velocity": np.array([0.1, 0.0, -0.6]), "initial_angular_velocity": np.zeros(3)}
    floor = Floor(np.zeros(3), np.array([0.1, 0.05, 1.0]), friction=0.3)
    folder = tmp_path / str(len(list(tmp_path.iterdir())))
    save_capture(Capture(folder, 48.0, 6, 6, floor=floor, **still), tets=tets)
    twin = base_twin(load_capture(folder), TwinOptions(weights=3, steps_per_frame=4))
    return FullModel(twin, NAMES, tets.vertices, 6, memory=memory)


class Counted(Crew):
    """A crew that counts its jobs."""

    def __init__(self, size=1):
        super().__init__(size)
        self.jobs = 0

    def run(self, function, jobs, **options):
        self.jobs += len(jobs)
        return super().run(function, jobs, **options)


def test_derivatives_of_a_body_that_strikes_are_carried_on_by_one_roll_out(tmp_path, monkeypatch):
    monkeypatch.setattr("physconvex.identify.roll_outs._LIGHT", 0.0)
    with Counted() as crew:
        model = box(tmp_path, RollOuts(crew=crew))
        model.linearise(TRUTH)
        assert crew.jobs == 4
        there = TRUTH + SCALES * [0.1, 0.2, -0.1]
        positions, tangents = model.followed(there, TRUTH)
        assert not model.known(there)[2] and model.known(TRUTH)[2]
        expected = positions - model.positions(TRUTH)
        np.testing.assert_allclose(np.einsum("tkpi,k->tpi", tangents, there - TRUTH), expected, atol=1e-12)
        _, fresh = model.linearise(there)
        assert model.known(there)[2]
        old, new = (np.einsum("tkpi,k->tkpi", t - fresh, SCALES) for t in (model.linearise(TRUTH)[1], tangents))
        assert np.linalg.norm(new) < np.linalg.norm(old)


def test_no_roll_out_is_made_twice_and_failures_are_remembered(tmp_path, monkeypatch):
    monkeypatch.setattr("physconvex.identify.roll_outs._LIGHT", 0.0)
    with Counted() as crew:
        model = box(tmp_path, RollOuts(crew=crew))
        half = replace(model, refinement=2)
        roll_out_together([(model, TRUTH), (half, TRUTH), (model, TRUTH)])
        assert crew.jobs == 2
        model.positions(TRUTH), half.node_positions(TRUTH)
        assert crew.jobs == 2
        model.linearise(TRUTH)
        model.linearise(TRUTH)
        assert crew.jobs == 5

        def fail(*arguments, **options):
            raise ConvergenceError("no")

        monkeypatch.setattr("physconvex.identify.roll_outs.simulate_full", fail)
        for _ in range(2):
            with pytest.raises(ConvergenceError, match="no"):
                model.positions(TRUTH + SCALES)
        assert crew.jobs == 6


def test_a_mesh_that_nobody_else_keeps_is_not_mistaken_for_a_later_one(tmp_path):
    model = box(tmp_path, RollOuts())
    mesh = refine(model.twin.mesh)
    replace(model, mesh=mesh).node_positions(TRUTH)
    kept = weakref.ref(mesh)
    del mesh
    gc.collect()
    assert kept() is not None  # else its place in memory, by which it is known, might be given away


def test_two_processes_find_the_same_to_the_last_bit(tmp_path, monkeypatch):
    monkeypatch.setattr("physconvex.identify.roll_outs._LIGHT", 0.0)
    found = []
    for size in (1, 2):
        with Crew(size) as crew:
            found.append(box(tmp_path, RollOuts(crew=crew)).linearise(TRUTH))
            assert len(crew._workers) == size - 1
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_light_work_starts_no_process(tmp_path):
    with Crew(2) as crew:
        box(tmp_path, RollOuts(crew=crew)).linearise(TRUTH)
        assert not crew._workers
