"""From half-spaces to points and back, and half-spaces that move."""

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.convex import (
    HalfSpaces,
    advect,
    affine_map,
    half_spaces,
    move_half_spaces,
    points_of_half_spaces,
)
from tests.convex.fields import cube, random_field
from tests.convex.hulls import hull_volumes, support


@pytest.mark.parametrize("points", [4, 6, 10])
def test_points_to_half_spaces_and_back(points):
    field = random_field(5, points=points, seed=points)
    again = field.with_points(points_of_half_spaces(half_spaces(field)))
    directions = torch.randn(50, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    torch.testing.assert_close(support(again, directions), support(field, directions), rtol=0, atol=1e-9)


def test_half_spaces_moved_affinely_bound_the_moved_points():
    field = random_field(4, seed=2)
    linear = torch.tensor([[1.2, 0.3, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.2, 1.4]], dtype=torch.float64)
    deform = affine_map(linear, torch.tensor([0.1, 0.2, 0.3]))
    moved = move_half_spaces(half_spaces(field), field.centres, deform)
    corners = field.with_points(points_of_half_spaces(moved))
    np.testing.assert_allclose(hull_volumes(corners), float(torch.det(linear)) * hull_volumes(field), rtol=1e-9)
    directions = torch.randn(50, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    expected = support(advect(field, deform), directions)
    torch.testing.assert_close(support(corners, directions), expected, rtol=0, atol=1e-9)


def test_fewer_points_lie_inside_and_lose_little():
    spaces = half_spaces(random_field(3, points=10, seed=3))
    full, few = (points_of_half_spaces(spaces, count=count) for count in (None, 6))
    field = random_field(3, points=10, seed=3)
    volumes = hull_volumes(field.with_points(full)), hull_volumes(field.with_points(few))
    assert few.shape == (3, 6, 3)
    assert (volumes[1] < volumes[0]).all() and (volumes[1] > 0.5 * volumes[0]).all()


def test_half_spaces_without_a_body_are_refused():
    spaces = half_spaces(cube())
    with pytest.raises(InputError, match="without bounds"):
        points_of_half_spaces(HalfSpaces(spaces.normals[:, :3], spaces.offsets[:, :3]))
    with pytest.raises(InputError, match="no volume in common"):
        points_of_half_spaces(HalfSpaces(spaces.normals, -spaces.offsets))
    with pytest.raises(InputError, match="count"):
        points_of_half_spaces(spaces, count=3)
