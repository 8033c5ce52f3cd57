"""Planar hulls against Qhull, and where points coincide or lie in line."""

import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull

from physconvex.render.hull import hull_indices


@pytest.mark.parametrize("count", [4, 6, 12, 40])
def test_corners_and_their_order_are_those_of_qhull(count: int) -> None:
    points = np.random.default_rng(count).normal(size=(30, count, 2))
    order, number = hull_indices(torch.as_tensor(points))
    for row in range(30):
        expected = ConvexHull(points[row]).vertices  # anticlockwise
        found = order[row, : number[row]].numpy()
        first = np.flatnonzero(expected == found[0])[0]
        np.testing.assert_array_equal(found, np.roll(expected, -first))


def test_points_in_line_and_repeated_points_are_no_corners() -> None:
    square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    between = [[0.5, 0], [1, 0.25], [0.5, 0.5], [0, 1]]
    line = [[0, 0], [1, 1], [3, 3], [2, 2], [0, 0], [3, 3], [1, 1], [2, 2]]
    points = torch.tensor([square + between, between + square, line, [[2, 5]] * 8], dtype=torch.float32)
    order, number = hull_indices(points)
    assert number.tolist() == [4, 4, 2, 1]
    corners = {tuple(corner) for corner in points[1][order[1, :4]].tolist()}
    assert corners == {(0, 0), (1, 0), (1, 1), (0, 1)}
    assert sorted(points[2][order[2, :2]].tolist()) == [[0, 0], [3, 3]]
