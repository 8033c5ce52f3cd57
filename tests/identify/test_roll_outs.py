"""Roll-outs that are remembered, and made in several processes."""

import gc
import pickle
import weakref
from dataclasses import replace

import numpy as np
import pytest

from physconvex import ConvergenceError
from physconvex.dynamics import GuessErrors, Timing, simulate
from physconvex.identify import FullModel, RollOuts, TwinOptions, base_twin, roll_out_together, roll_outs
from physconvex.io import Capture, Floor, Workers, load_capture, save_capture
from physconvex.mesh import TetMesh, box_mesh, refine_uniformly

NAMES, TRUTH = ("log10_youngs_modulus", "poisson_ratio", "damping_time"), np.array([4.3, 0.35, 1e-3])
SCALES = np.array([0.2, 0.1, 2e-3])


def box(tmp_path, memory):
    mesh = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=1)
    tets = TetMesh(mesh.vertices + np.array([0, 0, 0.012]), mesh.tets)
    still = {"initial_velocity": np.array([0.1, 0.0, -0.6]), "initial_angular_velocity": np.zeros(3)}
    floor = Floor(np.zeros(3), np.array([0.1, 0.05, 1.0]), friction=0.3)
    folder = tmp_path / str(len(list(tmp_path.iterdir())))
    save_capture(Capture(folder, 48.0, 6, 6, floor=floor, **still), tets=tets)
    twin = base_twin(load_capture(folder), TwinOptions(weights=3, steps_per_frame=4))
    return FullModel(twin, NAMES, tets.vertices, 6, memory=memory)


@pytest.fixture
def jobs(monkeypatch):
    """Roll-outs that are made, all of them worth a process."""
    made, original = [], RollOuts._made

    def counted(self, jobs):
        made.extend(jobs)
        return original(self, jobs)

    monkeypatch.setattr(RollOuts, "_made", counted)
    monkeypatch.setattr("physconvex.identify.roll_outs._LIGHT", 0.0)
    return made


def test_no_roll_out_is_made_twice_and_failures_are_remembered(tmp_path, monkeypatch, jobs):
    model = box(tmp_path, RollOuts())
    half = replace(model, refinement=2)
    roll_out_together([(model, TRUTH), (half, TRUTH), (model, TRUTH)])
    assert len(jobs) == 2
    model.positions(TRUTH), half.node_positions(TRUTH)
    assert len(jobs) == 2
    model.linearise(TRUTH)
    model.linearise(TRUTH)
    assert len(jobs) == 5

    def fail(*arguments, **options):
        raise ConvergenceError("no")

    monkeypatch.setattr("physconvex.identify.roll_outs.simulate", fail)
    for _ in range(2):
        with pytest.raises(ConvergenceError, match="no"):
            model.positions(TRUTH + SCALES)
    assert len(jobs) == 6


def test_a_mesh_that_nobody_else_keeps_is_not_mistaken_for_a_later_one(tmp_path):
    model = box(tmp_path, RollOuts())
    mesh = refine_uniformly(model.twin.mesh)
    replace(model, mesh=mesh).node_positions(TRUTH)
    kept = weakref.ref(mesh)
    del mesh
    gc.collect()
    assert kept() is not None  # else its place in memory, by which it is known, might be given away


def test_two_processes_find_the_same(tmp_path, jobs):
    """But for rounding: they use one thread each, and MKL's reproducible sums."""
    found = []
    for processes in (1, 2):
        with Workers(processes) as workers:
            found.append(box(tmp_path, RollOuts(workers=workers)).linearise(TRUTH))
            assert workers.running == (processes == 2)
        assert not workers.running
    (here, slopes), (there, others) = found
    np.testing.assert_allclose(here, there, rtol=0, atol=1e-12)
    np.testing.assert_allclose(slopes * SCALES[:, None, None], others * SCALES[:, None, None], rtol=0, atol=1e-10)


def test_light_work_starts_no_process(tmp_path):
    with Workers(2) as workers:
        box(tmp_path, RollOuts(workers=workers)).linearise(TRUTH)
        assert not workers.running


def test_a_failure_is_a_result(tmp_path, monkeypatch):
    def fail(*arguments, **options):
        raise ConvergenceError("no")

    monkeypatch.setattr(roll_outs, "simulate", fail)
    made = roll_outs._rolled_out(box(tmp_path, RollOuts()).roll_out(TRUTH))
    assert str(pickle.loads(pickle.dumps(made))) == "no"


def test_a_guided_roll_out_is_the_same_in_fewer_iterations(tmp_path):
    model = box(tmp_path, RollOuts())
    scene, beside = (model.scene(values) for values in (TRUTH, TRUTH + 0.01 * SCALES))
    how = Timing(frames=6, fps=48.0, steps_per_frame=8, contact_solver="condensed")
    guess_errors = GuessErrors()
    simulate(scene, how, recorded_errors=guess_errors)
    alone, guided = simulate(beside, how), simulate(beside, how, guess_errors=guess_errors)
    assert len(guess_errors) == 40
    assert np.abs(alone.positions - guided.positions).max() < 1e-6 * 0.3
    assert np.abs(alone.positions - simulate(scene, how).positions).max() > 1e-5 * 0.3  # they do differ
    assert guided.statistics.newton_iterations < 0.8 * alone.statistics.newton_iterations


def test_differences_are_guided_by_the_roll_out_they_are_taken_from(tmp_path, jobs):
    model = box(tmp_path, RollOuts())
    model.linearise(TRUTH)
    base, *beside = jobs
    assert base.guess_errors is None and all(len(job.guess_errors) == 20 for job in beside) and len(beside) == 3
