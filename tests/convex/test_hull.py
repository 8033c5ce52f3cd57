"""Planar hulls against Qhull, and where points coincide or lie in line."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull

from physconvex.render.compiled import planar_hulls_kernel
from physconvex.render.hull import Hulls, planar_hulls

Finder = Callable[[torch.Tensor], Hulls]
both = pytest.mark.parametrize("find", [planar_hulls, planar_hulls_kernel])


@both
@pytest.mark.parametrize("count", [4, 6, 12, 40])
def test_corners_and_their_order_are_those_of_qhull(find: Finder, count: int) -> None:
    points = np.random.default_rng(count).normal(size=(30, count, 2))
    hulls = find(torch.as_tensor(points))
    order, number = hulls.order, hulls.number
    for row in range(30):
        expected = ConvexHull(points[row]).vertices  # anticlockwise
        found = order[row, : number[row]].numpy()
        first = np.flatnonzero(expected == found[0])[0]
        np.testing.assert_array_equal(found, np.roll(expected, -first))


@both
def test_points_in_line_and_repeated_points_are_no_corners(find: Finder) -> None:
    square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    between = [[0.5, 0], [1, 0.25], [0.5, 0.5], [0, 1]]
    line = [[0, 0], [1, 1], [3, 3], [2, 2], [0, 0], [3, 3], [1, 1], [2, 2]]
    points = torch.tensor([square + between, between + square, line, [[2, 5]] * 8], dtype=torch.float32)
    hulls = find(points)
    order, number = hulls.order, hulls.number
    assert number.tolist() == [4, 4, 2, 1]
    corners = {tuple(corner) for corner in points[1][order[1, :4]].tolist()}
    assert corners == {(0, 0), (1, 0), (1, 1), (0, 1)}
    assert sorted(points[2][order[2, :2]].tolist()) == [[0, 0], [3, 3]]


@both
def test_width(find: Finder) -> None:
    angle = torch.tensor(0.3, dtype=torch.float64)
    turn = torch.stack([torch.stack([angle.cos(), -angle.sin()]), torch.stack([angle.sin(), angle.cos()])])
    rectangle = torch.tensor([[0.0, 0.0], [5.0, 0.0], [5.0, 0.7], [0.0, 0.7], [2.0, 0.3]], dtype=torch.float64)
    line = torch.tensor([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0], [3.0, 0.0], [2.0, 0.0]], dtype=torch.float64)
    widths = find(torch.stack([rectangle @ turn.T, line])).width
    torch.testing.assert_close(widths, torch.tensor([0.7, 0.0], dtype=torch.float64))


def test_both_finders_agree_bit_for_bit_also_in_float32_and_in_line() -> None:
    generator = torch.Generator().manual_seed(2)
    for kind in (torch.float32, torch.float64):
        points = torch.randn((3000, 6, 2), generator=generator, dtype=kind)
        points[:1000] = (2 * points[:1000]).round()  # many in line or equal
        slow, fast = planar_hulls(points), planar_hulls_kernel(points)
        assert torch.equal(slow.order, fast.order) and torch.equal(slow.number, fast.number)
        torch.testing.assert_close(slow.width, fast.width, rtol=1e-12, atol=1e-12)
