"""Meshes refined where they should be: conforming, of the same shape, finer there, not flat."""

import numpy as np
import pytest

from physconvex import InputError
from physconvex.mesh import EDGE_CORNERS, TetMesh, box_mesh, refine_locally
from physconvex.mesh.tet_mesh import mean_ratios


def edge_lengths(mesh: TetMesh, near: np.ndarray) -> np.ndarray:
    """Of the edges whose middle lies within 0.2 of a point."""
    ends = mesh.vertices[mesh.corner_tets[:, EDGE_CORNERS].reshape(-1, 2)]
    return np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)[np.linalg.norm(ends.mean(axis=1) - near, axis=1) < 0.2]


@pytest.mark.parametrize("order", [1, 2])
def test_edges_near_a_corner_get_shorter(order):
    mesh = box_mesh((1.0, 1.0, 1.0), (3, 3, 3), order=order)
    spacing = np.linalg.norm(mesh.vertices, axis=1) + 0.05
    budget = 3 * len(mesh.vertices)
    fine = refine_locally(mesh, spacing, max_nodes=budget)
    assert fine.order == order and 0.9 * budget < len(fine.vertices) <= budget
    assert edge_lengths(fine, np.zeros(3)).max() < 0.5 * edge_lengths(mesh, np.zeros(3)).max()
    assert edge_lengths(fine, np.ones(3)).min() == edge_lengths(mesh, np.ones(3)).min()
    np.testing.assert_allclose(fine.volume, 1.0, rtol=1e-12)
    np.testing.assert_allclose(fine.node_areas.sum(), 6.0, rtol=1e-12)  # elements fit face to face
    assert mean_ratios(fine.vertices, fine.corner_tets).min() > 0.4 * mean_ratios(mesh.vertices, mesh.tets).min()


def test_nothing_changes_without_a_budget():
    mesh = box_mesh((1.0, 2.0, 1.0), (1, 2, 1), order=2)
    same = refine_locally(mesh, np.ones(len(mesh.vertices)), max_nodes=len(mesh.vertices))
    np.testing.assert_array_equal(np.sort(same.vertices, axis=0), np.sort(mesh.vertices, axis=0))
    assert len(same.tets) == len(mesh.tets)


def test_bad_spacing_is_refused():
    mesh = box_mesh((1.0, 1.0, 1.0), (1, 1, 1), order=1)
    with pytest.raises(InputError, match="spacing: got shape"):
        refine_locally(mesh, np.ones(3), max_nodes=100)
    with pytest.raises(InputError, match="one positive length"):
        refine_locally(mesh, np.zeros(len(mesh.vertices)), max_nodes=100)
