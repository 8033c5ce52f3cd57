"""Lattice meshes of signed distance functions."""

import numpy as np
import pytest
import trimesh
from scipy.optimize import check_grad
from scipy.spatial import cKDTree

from physconvex import ConvergenceError, InputError
from physconvex.mesh import Embedding, TetMesh, box_mesh, overlap, tetrahedralize, tetrahedralize_implicit
from physconvex.mesh.implicit_meshing import _sampled, euler_characteristic, largest_piece
from physconvex.mesh.stuffing import stuff
from physconvex.mesh.surface_fitting import _distortion, fit_to_surface
from physconvex.mesh.tet_mesh import mean_ratios
from tests.mesh.quality import mesh_quality

UNIT = np.array([[-0.5] * 3, [0.5] * 3])


def ball(p):
    return np.linalg.norm(p, axis=1) - 0.5


def torus(p):
    return np.hypot(np.hypot(p[:, 0], p[:, 1]) - 0.36, p[:, 2]) - 0.14


def segment(p, start, end, radius):
    along = np.subtract(end, start)
    t = np.clip((p - start) @ along / (along @ along), 0, 1)
    return np.linalg.norm(p - start - t[:, None] * along, axis=1) - radius


def stool(p):
    """A plate on three legs whose thickness is about that of the lattice cells."""
    seat = np.maximum(np.hypot(p[:, 0], p[:, 1]) - 0.45, np.abs(p[:, 2] - 0.3) - 0.1)
    legs = [
        segment(
            p,
            np.array([0.3 * np.cos(a), 0.3 * np.sin(a), 0.3]),
            np.array([0.4 * np.cos(a), 0.4 * np.sin(a), -0.4]),
            0.08,
        )
        for a in 2 * np.pi * np.arange(3) / 3
    ]
    return np.minimum(seat, np.min(legs, axis=0))


@pytest.mark.parametrize("cell", [0.19, 0.15, 0.11])
@pytest.mark.parametrize(("body", "euler"), [(ball, 2), (torus, 0)])
def test_stuffing_has_the_angles_of_the_paper_and_boundary_nodes_on_the_surface(body, euler, cell):
    mesh = stuff(body, UNIT, cell)
    quality = mesh_quality(mesh)
    # theorem 1 of Labelle and Shewchuk for plane pieces of surface: 10.7 to 164.8 degrees
    assert quality.min_dihedral_deg > 10.7
    assert quality.max_dihedral_deg < 164.8
    assert np.abs(body(mesh.vertices[np.unique(mesh.boundary_faces)])).max() < 1e-3
    assert euler_characteristic(mesh.boundary_faces) == euler


def test_stuffed_volume_converges_with_second_order():
    errors = [np.pi / 6 - stuff(ball, UNIT, cell).volume for cell in (0.2, 0.1, 0.05)]
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert rates.mean() == pytest.approx(2.0, abs=0.4)


def test_stuffing_refuses_what_the_lattice_cannot_see():
    with pytest.raises(InputError, match="smaller cell"):
        stuff(lambda p: ball(p) + 0.49, UNIT, 0.3, offset=(0.2, 0.1, 0.3))
    with pytest.raises(InputError, match="cell"):
        stuff(ball, UNIT, 0.0)


def test_distortion_gradient_and_minimum():
    mesh = box_mesh((1.0, 1.0, 1.0), (2, 2, 2), order=1)
    x = mesh.vertices + np.random.default_rng(0).normal(0, 0.03, mesh.vertices.shape)

    def value(flat):
        return _distortion(flat.reshape(-1, 3), mesh.tets, np.zeros_like(x))

    def slope(flat):
        gradient = np.zeros_like(x)
        _distortion(flat.reshape(-1, 3), mesh.tets, gradient)
        return gradient.ravel()

    assert check_grad(value, slope, x.ravel()) < 1e-5 * np.linalg.norm(slope(x.ravel()))
    regular = np.array([[1.0, 1, 1], [1, -1, -1], [-1, -1, 1], [-1, 1, -1]])
    tet = np.array([[0, 1, 2, 3]])
    assert mean_ratios(regular, tet)[0] == pytest.approx(1.0)
    gradient = np.zeros((4, 3))
    assert _distortion(regular, tet, gradient) == pytest.approx(1.0)
    np.testing.assert_allclose(gradient, 0, atol=1e-12)


def test_fitting_draws_a_cube_to_a_larger_ball_without_flat_elements():
    cube = box_mesh((0.7, 0.7, 0.7), (3, 3, 3), order=1)
    cube = TetMesh(cube.vertices - 0.35, cube.tets)
    directions = np.random.default_rng(0).normal(size=(600, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    fitted = fit_to_surface(cube, 0.5 * directions, directions, rounds=10)
    radii = np.linalg.norm(fitted.vertices[np.unique(fitted.boundary_faces)], axis=1)
    before = np.linalg.norm(cube.vertices[np.unique(cube.boundary_faces)], axis=1)
    # a coarse chord mesh of a ball must straddle the surface: sagitta of its 0.25 m edges is 0.016 m
    assert np.sqrt(np.mean((radii - 0.5) ** 2)) < 0.03 < 0.5 * np.sqrt(np.mean((before - 0.5) ** 2))
    assert mean_ratios(fitted.vertices, fitted.tets).min() > 0.2


@pytest.mark.slow
@pytest.mark.parametrize(("body", "euler"), [(ball, 2), (torus, 0), (stool, 2)])
def test_meshes_keep_volume_topology_limbs_and_budget(body, euler):
    mesh = tetrahedralize_implicit(body, UNIT, max_nodes=600)
    fine = stuff(body, UNIT, 1 / 20)
    assert mesh.order == 2
    assert 300 < len(mesh.vertices) <= 600
    assert mesh.volume == pytest.approx(fine.volume, rel=1e-2)
    assert euler_characteristic(mesh.boundary_faces[:, :3]) == euler
    assert Embedding.of_points(mesh, fine.vertices).max_distance < 0.1
    assert mesh_quality(mesh).min_dihedral_deg > 8


def test_equal_arguments_give_equal_meshes_and_linear_ones_have_the_budget_too():
    first, second = (tetrahedralize_implicit(torus, UNIT, max_nodes=120, order=1) for _ in range(2))
    np.testing.assert_array_equal(first.vertices, second.vertices)
    np.testing.assert_array_equal(first.tets, second.tets)
    assert first.order == 1
    assert len(first.vertices) <= 120


def test_what_cannot_be_meshed_is_refused():
    with pytest.raises(ConvergenceError, match="allow more nodes"):
        tetrahedralize_implicit(lambda p: segment(p, [-0.45, 0, 0], [0.45, 0, 0], 0.045), UNIT, max_nodes=40)
    with pytest.raises(InputError, match="nowhere negative"):
        tetrahedralize_implicit(lambda p: ball(p) + 2, UNIT)
    with pytest.raises(InputError, match="bounds"):
        tetrahedralize_implicit(ball, UNIT[::-1])
    with pytest.raises(InputError, match="max_nodes"):
        tetrahedralize_implicit(ball, UNIT, max_nodes=3)


def test_the_largest_piece_is_kept_and_two_equal_pieces_are_none():
    big, small = box_mesh((1.0, 1.0, 1.0), (2, 2, 2), order=1), box_mesh((0.1, 0.1, 0.1), (1, 1, 1), order=1)

    def together(a, b):
        return TetMesh(np.vstack([a.vertices, b.vertices + 3]), np.vstack([a.tets, len(a.vertices) + b.tets]))

    kept = largest_piece(together(big, small))
    assert kept is not None
    assert kept.volume == pytest.approx(1.0)
    assert largest_piece(together(big, big)) is None


def test_a_bar_of_twelve_triangles_keeps_its_shape():
    """Samples at the centres of the triangles are twelve points: the mesh then bulged by a tenth of the length."""
    bar = trimesh.creation.box((1.0, 0.25, 0.25))
    surface = np.asarray(bar.vertices), np.asarray(bar.faces)
    mesh = tetrahedralize(bar, method="lattice", order=2, max_nodes=6300)
    assert overlap(mesh, *surface) > 0.98
    np.testing.assert_allclose(np.abs(mesh.vertices).max(axis=0), [0.5, 0.125, 0.125], atol=0.025)


def test_samples_spread_over_large_triangles_and_lie_amid_small_ones():
    large = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0.0]]), np.array([[0, 1, 2]])
    points, normals = _sampled(*large)
    cells = np.floor(points[:, :2] * 8).astype(int)
    assert len(np.unique(cells, axis=0)) == 36  # all the cells of 1/8 that lie in the triangle
    assert (points[:, :2].sum(axis=1) <= 1).all() and (normals == [0, 0, 1]).all()
    fine = trimesh.creation.icosphere(subdivisions=5)
    points, _ = _sampled(np.asarray(fine.vertices), np.asarray(fine.faces))
    assert cKDTree(fine.triangles_center).query(points)[0].max() < 1e-12
