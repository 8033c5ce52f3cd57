"""What is held of a geometry, carried over to other meshes of it."""

import numpy as np
import pytest

from physconvex.identify import HeldRegion, clamp_of
from physconvex.io import Boundary
from physconvex.mesh import box_mesh, tetrahedralize

SIZE = (0.1, 0.03, 0.03)
THIN = Boundary(clamped_box=np.array([[-1e-4, -1.0, -1.0], [1e-4, 1.0, 1.0]]))


@pytest.fixture(scope="module")
def fine():
    return box_mesh(SIZE, (20, 6, 6), order=1)


def test_a_mesh_made_anew_is_held_over_the_whole_face(fine):
    """Its surface lies a millimetre off the reference's, outside a box that holds the reference's face alone."""
    used, faces = np.unique(fine.boundary_faces, return_inverse=True)
    mesh = tetrahedralize((fine.vertices[used], faces.reshape(-1, 3)), max_nodes=200, order=2, method="lattice")
    assert ((mesh.vertices >= THIN.clamped_box[0]) & (mesh.vertices <= THIN.clamped_box[1])).all(1).sum() < 4
    clamp = clamp_of(THIN, mesh, reference=fine.vertices, cells=fine.tets, fps=50.0)
    held = mesh.vertices[clamp.nodes]
    assert np.abs(held[:, 0]).max() < 0.005
    assert (np.ptp(held[:, 1:], axis=0) > 0.9 * np.array(SIZE[1:])).all()
    assert 0.8 < clamp.springs().areas.sum() / (SIZE[1] * SIZE[2]) < 1.8  # rims carry a share of the sides too


@pytest.mark.parametrize("with_tets", [True, False])
def test_a_finer_mesh_is_held_no_deeper_than_the_reference(with_tets):
    coarse, finer = box_mesh(SIZE, (3, 1, 1), order=1), box_mesh(SIZE, (20, 4, 4))
    cells = coarse.tets if with_tets else coarse.boundary_faces
    held = np.flatnonzero(coarse.vertices[:, 0] == 0)
    clamp = clamp_of(Boundary(clamped_vertices=held), finer, reference=coarse.vertices, cells=cells, fps=50.0)
    assert len(clamp.nodes) == 81 and finer.vertices[clamp.nodes, 0].max() == 0


def test_a_held_volume_holds_all_of_it(fine):
    """Vertices up to x = 0.02: tetrahedra between them are held inside too, also for a mesh that is much finer."""
    held = np.flatnonzero(fine.vertices[:, 0] < 0.0201)
    region = HeldRegion.of(fine.vertices, held, fine.tets)
    points = np.random.default_rng(0).uniform(0, SIZE, (2000, 3))
    np.testing.assert_array_equal(region.holds(points, reach=1e-9), points[:, 0] <= 0.02)


def test_single_vertices_hold_the_nearest_points(fine):
    region = HeldRegion.of(fine.vertices, np.array([0]), fine.tets)
    points = fine.vertices[0] + np.array([[0.004, 0, 0], [0.001, 0.001, 0], [0.03, 0, 0]])
    assert region.holds(points, reach=1e-3).tolist() == [False, True, False]
    nothing = HeldRegion.of(fine.vertices, np.zeros(0, np.int64), fine.tets)
    assert not nothing.holds(points, reach=1.0).any()
