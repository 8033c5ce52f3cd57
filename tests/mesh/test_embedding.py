"""Points carried by a mesh."""

import numpy as np
import pytest

from physconvex import InputError
from physconvex.mesh import Embedding, TetMesh, box_mesh, locate, sample_interior
from physconvex.mesh.embedding import contains


def linear_field(x):
    return np.stack([1 + 2 * x[..., 0] - x[..., 2], x[..., 1] + 3 * x[..., 2], -x[..., 0]], axis=-1)


def quadratic_field(x):
    a, b, c = np.moveaxis(x, -1, 0)
    return np.stack([a * b - c**2, 1 + a**2 + b * c, a * c - 2 * b**2 + c], axis=-1)


@pytest.mark.parametrize(("order", "field"), [(1, linear_field), (2, linear_field), (2, quadratic_field)])
def test_fields_of_the_element_order_are_reproduced_inside(order, field):
    mesh = box_mesh((1.0, 0.7, 0.4), (3, 2, 2), order=order)
    points = np.random.default_rng(0).uniform(0, [1.0, 0.7, 0.4], (500, 3))
    embedding = Embedding.of_points(mesh, points)
    np.testing.assert_allclose(embedding.apply(field(mesh.vertices)), field(points), atol=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_affine_maps_are_reproduced_far_outside(order):
    mesh = box_mesh((1.0, 0.7, 0.4), (3, 2, 2), order=order)
    points = np.random.default_rng(0).uniform(-2.0, 3.0, (500, 3))
    embedding = Embedding.of_points(mesh, points)
    np.testing.assert_allclose(embedding.apply(linear_field(mesh.vertices)), linear_field(points), atol=1e-11)


def test_outside_points_follow_the_nearest_point_and_the_mean_gradient_of_its_element():
    """Beyond the face x = 1 the nearest point is (1, y, z), where a x² field is 1; its gradient is linear over the
    element, so that the mean is the one at the centre, 2 x̄, the same for all of these points.
    """
    mesh = box_mesh((1.0, 0.7, 0.4), (3, 2, 2), order=2)
    beyond = np.array([1e-7, 0.01, 0.3, 2.0])
    points = np.stack([1 + beyond, np.full(4, 0.31), np.full(4, 0.17)], axis=-1)
    embedding = Embedding.of_points(mesh, points)
    centre = mesh.vertices[mesh.corner_tets[embedding.elements]].mean(axis=1)
    assert 0.6 < centre[0, 0] < 1.0
    carried = embedding.apply(mesh.vertices**2)
    np.testing.assert_allclose(carried[:, 0], 1 + 2 * centre[:, 0] * beyond, atol=1e-11)
    np.testing.assert_allclose(carried[:, 1:], np.broadcast_to([0.31**2, 0.17**2], (4, 2)), atol=1e-11)


def test_the_continuation_joins_the_motion_of_the_surface():
    mesh = box_mesh((1.0, 0.7, 0.4), (2, 2, 2), order=2)
    rng = np.random.default_rng(6)
    moved = mesh.vertices + 0.05 * rng.normal(size=mesh.vertices.shape)
    surface = rng.uniform(0, [1.0, 0.7, 0.4], (200, 3))
    side = rng.integers(0, 3, 200)
    surface[np.arange(200), side] = np.array([1.0, 0.7, 0.4])[side]
    outwards = np.eye(3)[side]
    inner, outer = (Embedding.of_points(mesh, surface + gap * outwards) for gap in (-1e-8, 1e-8))
    assert inner.max_distance == 0.0 < outer.max_distance
    # gradients of the random motion are about 0.05 / 0.1 nodal distance: 1e-8 in position, 1e-8 × a few carried
    np.testing.assert_allclose(outer.apply(moved), inner.apply(moved), atol=5e-7)


def test_a_linear_mesh_does_not_reproduce_a_quadratic_field():
    mesh = box_mesh((1.0, 0.7, 0.4), (3, 2, 2), order=1)
    points = np.random.default_rng(0).uniform(0, [1, 0.7, 0.4], (50, 3))
    carried = Embedding.of_points(mesh, points).apply(quadratic_field(mesh.vertices))
    assert np.abs(carried - quadratic_field(points)).max() > 1e-3


def test_inside_points_lie_in_the_reported_element():
    mesh = box_mesh((1.0, 1.0, 1.0), (4, 4, 4), order=1)
    points = np.random.default_rng(1).random((300, 3))
    embedding = Embedding.of_points(mesh, points)
    assert embedding.weights.min() >= -1e-9
    assert embedding.max_distance == 0.0
    carried = np.einsum("pn,pna->pa", embedding.weights, mesh.vertices[mesh.tets[embedding.elements]])
    np.testing.assert_allclose(carried, points, atol=1e-12)


def test_graded_mesh_where_the_nearest_centres_are_not_the_containing_element():
    """One huge element beside many tiny ones: only the exhaustive search finds it."""
    tiny = box_mesh((0.02, 0.02, 0.02), (4, 4, 4), order=1)
    huge = np.array([[0.03, 0.0, 0.0], [9.0, 0.0, 0.0], [0.03, 9.0, 0.0], [0.03, 0.0, 9.0]])
    mesh = TetMesh(np.vstack([tiny.vertices, huge]), np.vstack([tiny.tets, len(tiny.vertices) + np.arange(4)]))
    embedding = Embedding.of_points(mesh, np.array([[0.0301, 0.001, 0.001]]))
    assert embedding.elements[0] == len(tiny.tets)
    assert embedding.max_distance == 0.0


def test_what_lies_inside_is_told_as_by_the_place_of_every_point():
    rng = np.random.default_rng(3)
    mesh = box_mesh((1.0, 0.7, 0.4), (4, 2, 2))
    graded = TetMesh(mesh.vertices**3, mesh.tets)
    points = rng.uniform(-0.1, 1.1, (3000, 3)) * [1.0, 0.7**3, 0.4**3]
    box = ((points >= 0) & (points <= [1.0, 0.7**3, 0.4**3])).all(1)
    assert 500 < box.sum() < 2500
    np.testing.assert_array_equal(contains(graded, points), box)
    np.testing.assert_array_equal(locate(graded, points)[3] == 0, box)
    assert len(contains(graded, points[:0])) == 0 and not contains(graded, points[:5] + 9).any()


def test_the_distance_of_outside_points_is_reported():
    mesh = box_mesh((1.0, 1.0, 1.0), (2, 2, 2), order=2)
    face, edge, corner = [0.5, 0.5, 1.1], [0.5, 1.3, 1.4], [-0.2, -0.1, -0.2]
    distances = [Embedding.of_points(mesh, np.array([p])).max_distance for p in (face, edge, corner)]
    np.testing.assert_allclose(distances, [0.1, 0.5, 0.3], atol=1e-12)


def test_a_rigid_motion_carries_outside_points_along():
    mesh = box_mesh((1.0, 1.0, 1.0), (2, 2, 2), order=2)
    points = np.random.default_rng(2).uniform(-0.3, 1.3, (200, 3))
    rotation = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    embedding = Embedding.of_points(mesh, points)
    frames = np.stack([mesh.vertices, mesh.vertices @ rotation + 0.5])
    carried = embedding.apply(frames)
    assert carried.shape == (2, 200, 3)
    np.testing.assert_allclose(carried[0], points, atol=1e-12)
    np.testing.assert_allclose(carried[1], points @ rotation + 0.5, atol=1e-12)


def test_bad_points_and_positions_are_refused():
    mesh = box_mesh((1.0, 1.0, 1.0), (1, 1, 1))
    with pytest.raises(InputError, match="points"):
        Embedding.of_points(mesh, np.array([[0.0, np.nan, 0.0]]))
    with pytest.raises(InputError, match="positions"):
        Embedding.of_points(mesh, np.zeros((1, 3))).apply(np.zeros((3, 3)))


def test_interior_samples_integrate_the_volume_and_a_linear_field():
    mesh = box_mesh((2.0, 1.0, 0.5), (5, 4, 3), order=2)
    points, weights = sample_interior(mesh, 4000, np.random.default_rng(4))
    assert weights.sum() == pytest.approx(mesh.volume, rel=1e-12)
    assert Embedding.of_points(mesh, points).max_distance == 0.0
    # standard error of the mean of independent draws: 2 / sqrt(12 * 4000) = 0.009; stratified draws are better
    np.testing.assert_allclose(weights @ points / mesh.volume, [1.0, 0.5, 0.25], atol=0.01)


def test_interior_samples_depend_on_the_generator_alone():
    mesh = box_mesh((1.0, 1.0, 1.0), (2, 2, 2))
    first, second = (sample_interior(mesh, 50, np.random.default_rng(5))[0] for _ in range(2))
    np.testing.assert_array_equal(first, second)
    with pytest.raises(InputError, match="count"):
        sample_interior(mesh, 0, np.random.default_rng(5))
