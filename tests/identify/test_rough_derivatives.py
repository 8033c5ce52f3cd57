"""Derivatives of the full model of a body that strikes a floor, smooth or rough: slopes that hold at every scale."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex.dynamics import simulate
from physconvex.identify import FullModel, TwinOptions, base_twin
from physconvex.io import Capture, Floor, load_capture, save_capture
from physconvex.mesh import TetMesh, box_mesh

NAMES = ("log10_youngs_modulus", "poisson_ratio", "damping_time")
VALUES, STEPS = np.array([4.3, 0.35, 1e-3]), np.array([0.02, 0.01, 2e-4])


def model(tmp_path, friction):
    box = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=1)
    tets = TetMesh(box.vertices + np.array([0, 0, 0.012]), box.tets)
    still = {"initial_velocity": np.array([0.1, 0.0, -0.6]), "initial_angular_velocity": np.zeros(3)}
    floor = Floor(np.zeros(3), np.array([0.1, 0.05, 1.0]), friction=friction)
    save_capture(Capture(tmp_path / "box", 48.0, 6, 6, floor=floor, **still), tets=tets)
    twin = base_twin(load_capture(tmp_path / "box"), TwinOptions(weights=3, steps_per_frame=4))
    return FullModel(twin, NAMES, tets.vertices, 6)


def slopes(full, share):
    """Central differences over a share of the steps [T, K, P, 3]."""
    out = []
    for change in np.diag(share * STEPS):
        out.append((full.positions(VALUES + change) - full.positions(VALUES - change)) / (2 * change.sum()))
    return np.stack(out, axis=1)


@pytest.mark.parametrize("friction", [0.0, 0.6])
def test_slopes_are_the_same_over_small_and_large_changes(tmp_path, friction):
    """With friction frozen pass by pass, as many times as it takes, they differ by a third and more."""
    full = model(tmp_path, friction)
    positions, tangents = full.linearise(VALUES)
    np.testing.assert_array_equal(positions, full.positions(VALUES))
    for share in (1e-3, 1e-2, 1e-1):
        expected = slopes(full, share)
        for k in range(len(NAMES)):
            error = np.linalg.norm(tangents[:, k] - expected[:, k])
            assert error < 0.03 * np.linalg.norm(expected[:, k]), (share, NAMES[k])


def test_contact_and_friction_are_solved_for_together_where_the_law_allows_it(tmp_path):
    full = model(tmp_path, 0.6)
    timing = full.roll_out(VALUES).timing
    expected = simulate(full.scene(VALUES), timing)
    np.testing.assert_array_equal(full.node_positions(VALUES), expected.positions)
    assert replace(full, names=(*NAMES, "contact_damping")).linearise(np.append(VALUES, 0.0))[1].shape[1] == 4
    damped = replace(full, twin=full.twin.with_scene(contact_damping=1e-3))
    expected = simulate(damped.scene(VALUES), damped.roll_out(VALUES).timing)
    np.testing.assert_array_equal(damped.node_positions(VALUES), expected.positions)


def test_at_a_bound_the_other_side_is_taken(tmp_path):
    full = model(tmp_path, 0.6)
    at_the_top = np.array([4.3, 0.495, 1e-3])
    _, tangents = full.linearise(at_the_top)
    lower = at_the_top - [0, 0.1 * STEPS[1], 0]
    expected = (full.positions(at_the_top) - full.positions(lower)) / (0.1 * STEPS[1])
    np.testing.assert_allclose(tangents[:, 1], expected, atol=1e-6)


def test_values_that_are_held_cost_no_roll_out(tmp_path):
    full = model(tmp_path, 0.6)
    _, tangents = full.linearise(VALUES)
    held = replace(full, held=("poisson_ratio",))
    assert len(held.beside(VALUES)) == 2
    _, others = held.linearise(VALUES)
    np.testing.assert_array_equal(others[:, [0, 2]], tangents[:, [0, 2]])
    assert not others[:, 1].any() and tangents[:, 1].any()
