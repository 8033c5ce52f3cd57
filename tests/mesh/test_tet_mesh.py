"""Tetrahedral meshes: boxes, refinement, quadratic nodes, boundary, areas, quadrature, errors."""

from math import factorial

import numpy as np
import pytest

from physconvex import InputError
from physconvex.mesh import (
    EDGE_CORNERS,
    QUADRATURE,
    TetMesh,
    box_mesh,
    compact,
    linear_part,
    refine_uniformly,
    shape_gradients,
    shape_values,
    to_quadratic,
)

SIZE, CELLS = (0.4, 0.3, 0.2), (3, 2, 2)


def surface_area(size) -> float:
    a, b, c = size
    return 2 * (a * b + b * c + c * a)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("order", [1, 2])
def test_box_has_the_right_volume_and_size(order, mirrored):
    mesh = box_mesh(SIZE, CELLS, order=order, mirrored=mirrored)
    assert mesh.order == order
    assert len(mesh.tets) == 6 * np.prod(CELLS)
    assert mesh.volume == pytest.approx(np.prod(SIZE))
    assert mesh.size == pytest.approx(0.4)
    assert (mesh.element_volumes > 0).all()
    expected_nodes = np.prod(np.array(CELLS) * order + 1)  # P2 nodes of a Kuhn box are the grid at half the spacing
    assert len(mesh.vertices) == expected_nodes


def test_cells_of_a_mirrored_box_are_mirror_images():
    mesh = box_mesh((1.0, 1.0, 1.0), (2, 4, 2), mirrored=True)
    centres = mesh.vertices[mesh.corner_tets].mean(1)
    for axis in range(3):
        image = centres.copy()
        image[:, axis] = 1.0 - image[:, axis]
        assert set(map(tuple, image.round(9))) == set(map(tuple, centres.round(9)))
    plain = box_mesh((1.0, 1.0, 1.0), (2, 4, 2))
    assert len(mesh.vertices) == len(plain.vertices) and len(mesh.boundary_faces) == len(plain.boundary_faces)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("order", [1, 2])
def test_boundary_is_closed_and_points_outwards(order, mirrored):
    mesh = box_mesh(SIZE, CELLS, order=order, mirrored=mirrored)
    x = mesh.vertices[mesh.boundary_faces[:, :3]]
    areas = 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    np.testing.assert_allclose(areas.sum(0), 0.0, atol=1e-14)  # closed
    assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(surface_area(SIZE))
    assert (x.mean(1) * areas).sum() / 3 == pytest.approx(mesh.volume)  # divergence theorem: outward
    assert len(mesh.boundary_faces) == 4 * sum(a * b for a, b in ((3, 2), (2, 2), (3, 2)))


def test_quadratic_faces_carry_the_middles_of_their_edges():
    mesh = box_mesh(SIZE, CELLS)
    x = mesh.vertices[mesh.boundary_faces]
    for middle, (i, j) in zip((3, 4, 5), ((0, 1), (1, 2), (2, 0)), strict=True):
        np.testing.assert_allclose(x[:, middle], 0.5 * (x[:, i] + x[:, j]), atol=1e-15)


@pytest.mark.parametrize("order", [1, 2])
def test_node_areas_add_up_to_the_surface(order):
    mesh = box_mesh(SIZE, CELLS, order=order)
    assert mesh.node_areas.sum() == pytest.approx(surface_area(SIZE))
    on_surface = np.isin(mesh.vertices, [0.0]).any(1) | np.isclose(mesh.vertices, SIZE).any(1)
    assert ((mesh.node_areas > 0) == on_surface).all()


def test_middle_nodes_lie_in_the_middle_and_are_shared():
    linear = box_mesh(SIZE, CELLS, order=1)
    mesh = to_quadratic(linear)
    middles = mesh.vertices[mesh.corner_tets][:, EDGE_CORNERS].mean(2)
    np.testing.assert_allclose(mesh.vertices[mesh.tets[:, 4:]], middles, atol=1e-15)
    assert len(np.unique(mesh.vertices.round(9), axis=0)) == len(mesh.vertices)  # no node twice
    assert to_quadratic(mesh) is mesh
    back = linear_part(mesh)
    np.testing.assert_array_equal(back.tets, linear.tets)


@pytest.mark.parametrize("order", [1, 2])
def test_refinement_keeps_the_geometry(order):
    mesh = box_mesh(SIZE, (1, 1, 1), order=order)
    fine = refine_uniformly(mesh)
    assert fine.order == order
    assert len(fine.tets) == 8 * len(mesh.tets)
    assert fine.volume == pytest.approx(mesh.volume)
    assert fine.node_areas.sum() == pytest.approx(surface_area(SIZE))
    expected = np.repeat(mesh.element_volumes / 8, 8)
    np.testing.assert_allclose(fine.element_volumes, expected)
    assert len(np.unique(fine.vertices.round(9), axis=0)) == len(fine.vertices)


def test_refinement_of_random_tetrahedra_is_conforming():
    rng = np.random.default_rng(1)
    mesh = box_mesh((1.0, 1.0, 1.0), (2, 2, 2), order=1)
    inner = mesh.node_areas == 0
    moved = mesh.vertices + inner[:, None] * rng.uniform(-0.1, 0.1, size=mesh.vertices.shape)
    fine = refine_uniformly(refine_uniformly(TetMesh(moved, mesh.tets)))
    assert fine.volume == pytest.approx(1.0)
    assert fine.node_areas.sum() == pytest.approx(6.0)  # a hanging node would open inner faces


def test_compact_drops_unused_vertices():
    vertices = np.vstack([np.full((2, 3), 9.0), np.zeros(3), np.eye(3)])
    mesh = compact(vertices, np.array([[2, 3, 4, 5]]))
    np.testing.assert_array_equal(mesh.tets, [[0, 1, 2, 3]])
    assert mesh.volume == pytest.approx(1 / 6)


TET = np.vstack([np.zeros(3), np.eye(3)])


@pytest.mark.parametrize(
    ("vertices", "tets", "message"),
    [
        (TET, [[0, 2, 1, 3]], "1 of 1 have no positive volume"),
        (TET * (1, 1, 0), [[0, 1, 2, 3]], "no positive volume"),
        (TET, [[0, 1, 2, 4]], "indices 0..4; expected 0..3"),
        pytest.param(TET[:, :2], [[0, 1, 2, 3]], r"vertices: got shape \(4, 2\)", marks=pytest.mark.wrong_types),
        (TET * np.nan, [[0, 1, 2, 3]], "vertices"),
        (TET, [[0, 1, 2]], r"tets: got shape \(1, 3\)"),
        (np.vstack([TET, TET[:1]]), [[0, 1, 2, 3]], "belong to no tetrahedron"),
    ],
)
def test_bad_meshes_are_named(vertices, tets, message):
    with pytest.raises(InputError, match=message):
        TetMesh(vertices, np.array(tets))


@pytest.mark.parametrize("shares", [[0.5, 0.5], [0.5, 0.5, 0.5, -0.5], [0.3, 0.3, 0.3, 0.3]])
def test_bad_shares_of_the_mass_are_named(shares):
    with pytest.raises(InputError, match="mass_shares: got shape"):
        TetMesh(TET, np.array([[0, 1, 2, 3]]), np.array(shares))


# --- shape functions and quadrature


@pytest.mark.parametrize("degree", sorted(QUADRATURE))
def test_quadrature_is_exact_to_its_degree(degree):
    points, weights = QUADRATURE[degree]
    np.testing.assert_allclose(points.sum(1), 1.0, atol=1e-14)
    for powers in np.ndindex(*[degree + 1] * 4):
        if sum(powers) <= degree:
            # ∫ b₀^i b₁^j b₂^k b₃^l over a tetrahedron of volume one = 3! i! j! k! l! / (i+j+k+l+3)!
            exact = 6 * np.prod([factorial(p) for p in powers]) / factorial(sum(powers) + 3)
            assert weights @ np.prod(points**powers, axis=1) == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_shape_functions_are_one_at_their_node_and_sum_to_one(order):
    corners = np.eye(4)
    nodes = corners if order == 1 else np.vstack([corners, corners[EDGE_CORNERS].mean(1)])
    np.testing.assert_allclose(shape_values(nodes, order), np.eye(len(nodes)), atol=1e-15)
    points = np.random.default_rng(0).dirichlet(np.ones(4), size=5)
    np.testing.assert_allclose(shape_values(points, order).sum(1), 1.0)


@pytest.mark.parametrize("order", [1, 2])
def test_shape_gradients_are_derivatives(order):
    points, step = np.random.default_rng(0).dirichlet(np.ones(4), size=5), 1e-6
    got = shape_gradients(points, order)
    for axis, direction in enumerate(np.eye(4)):
        change = shape_values(points + step * direction, order) - shape_values(points - step * direction, order)
        np.testing.assert_allclose(got[:, :, axis], change / (2 * step), atol=1e-9)
