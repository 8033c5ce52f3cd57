"""Derivatives of the full model of a body that strikes a floor: exact on a smooth one, slopes on a rough one."""

import numpy as np
import pytest

from physconvex.capture import Capture, Floor, load_capture, save_capture
from physconvex.fem import TetMesh, box_mesh
from physconvex.identify import FullModel, TwinOptions, base_twin

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


@pytest.mark.parametrize(("friction", "tolerance"), [(0.0, 2e-2), (0.6, 0.15)])
def test_they_are_slopes_over_changes_that_matter(tmp_path, friction, tolerance):
    full = model(tmp_path, friction)
    positions, tangents = full.linearise(VALUES)
    np.testing.assert_array_equal(positions, full.positions(VALUES))
    expected = slopes(full, 0.05 if friction == 0 else 1.0)
    for k in range(len(NAMES)):
        error = np.linalg.norm(tangents[:, k] - expected[:, k])
        assert error < tolerance * np.linalg.norm(expected[:, k])


def test_at_a_bound_the_other_side_is_taken(tmp_path):
    full = model(tmp_path, 0.6)
    at_the_top = np.array([8.0, 0.495, 0.1])
    _, tangents = full.linearise(at_the_top)
    lower = at_the_top - [0, STEPS[1], 0]
    expected = (full.positions(at_the_top) - full.positions(lower)) / STEPS[1]
    np.testing.assert_allclose(tangents[:, 1], expected, atol=1e-9)
