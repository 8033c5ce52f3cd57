"""Roll-outs that are remembered, and made in several processes."""

import gc
import os
import pickle
import weakref
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from physconvex.capture import Capture, Floor, load_capture, save_capture
from physconvex.errors import ConvergenceError
from physconvex.fem import TetMesh, box_mesh, refine
from physconvex.identify import FullModel, RollOuts, TwinOptions, base_twin, roll_out_together, roll_outs

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

    monkeypatch.setattr("physconvex.identify.roll_outs.simulate_full", fail)
    for _ in range(2):
        with pytest.raises(ConvergenceError, match="no"):
            model.positions(TRUTH + SCALES)
    assert len(jobs) == 6


def test_a_mesh_that_nobody_else_keeps_is_not_mistaken_for_a_later_one(tmp_path):
    model = box(tmp_path, RollOuts())
    mesh = refine(model.twin.mesh)
    replace(model, mesh=mesh).node_positions(TRUTH)
    kept = weakref.ref(mesh)
    del mesh
    gc.collect()
    assert kept() is not None  # else its place in memory, by which it is known, might be given away


def test_two_processes_find_the_same_to_the_last_bit(tmp_path, jobs):
    found = []
    for processes in (1, 2):
        with RollOuts(processes=processes) as memory:
            found.append(box(tmp_path, memory).linearise(TRUTH))
            assert (memory._pool is None) == (processes == 1)
        assert memory._pool is None
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_failure_comes_back_from_another_process_as_a_result(tmp_path, monkeypatch):
    job = pickle.dumps(box(tmp_path, RollOuts()).roll_out(TRUTH))

    def fail(*arguments, **options):
        raise ConvergenceError("no")

    monkeypatch.setattr(roll_outs, "simulate_full", fail)
    assert str(pickle.loads(pickle.dumps(roll_outs._from_bytes(job)))) == "no"


def test_where_processes_die_the_work_is_done_here(tmp_path, jobs):
    with RollOuts(processes=2) as memory:
        model = box(tmp_path, memory)
        memory._pool = ProcessPoolExecutor(1, initializer=os._exit, initargs=(1,))
        with pytest.warns(RuntimeWarning, match="one after the other"):
            roll_out_together([(model, TRUTH), (model, TRUTH + SCALES)])
        assert np.isfinite(model.positions(TRUTH)).all() and memory.processes == 1


def test_light_work_starts_no_process(tmp_path):
    with RollOuts(processes=2) as memory:
        box(tmp_path, memory).linearise(TRUTH)
        assert memory._pool is None
