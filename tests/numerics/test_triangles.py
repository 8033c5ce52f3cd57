"""The closest point of a triangle, by region and against a fine net."""

import numpy as np

from physconvex.numerics import closest_in_triangles, closest_points


def test_closest_points_in_a_triangle_by_region():
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    points = np.array([[0.25, 0.25, 2], [-1, -1, 0], [2, -1, 0], [0.5, -1, 1], [1, 1, 0]])
    weights = closest_in_triangles(np.broadcast_to(triangle, (5, 3, 3)), points)
    expected = [[0.25, 0.25, 0], [0, 0, 0], [1, 0, 0], [0.5, 0, 0], [0.5, 0.5, 0]]
    np.testing.assert_allclose(weights @ triangle, expected, atol=1e-14)


def test_the_closest_point_of_triangles_beats_a_fine_net():
    rng = np.random.default_rng(0)
    points, corners = rng.normal(size=(40, 3)), rng.normal(size=(40, 3, 3))
    shares = closest_in_triangles(corners, points)
    assert (shares >= 0).all() and np.allclose(shares.sum(1), 1)
    found = np.einsum("nc,nci->ni", shares, corners)
    np.testing.assert_allclose(closest_points(corners, points), found, atol=1e-12)
    distance = np.linalg.norm(found - points, axis=1)
    net = np.array([(i, j, 60 - i - j) for i in range(61) for j in range(61 - i)]) / 60
    nets = np.linalg.norm(np.einsum("kc,nci->nki", net, corners) - points[:, None], axis=2).min(1)
    assert (distance <= nets + 1e-12).all() and (distance > nets - 0.05).all()
