"""Quick halving: parts lie in the whole and fill nearly all of it."""

import numpy as np
import pytest
import torch

from physconvex.convex import halve, inside_union
from tests.convex.fields import random_field
from tests.convex.hulls import hull_volumes


def prism_field(count: int = 40):
    generator = torch.Generator().manual_seed(0)
    triangle = torch.randn(count, 3, 3, generator=generator, dtype=torch.float64)
    a, b, c = triangle.unbind(dim=1)
    normal = torch.linalg.cross(b - a, c - a)
    inward = 0.5 * (normal / normal.norm(dim=1, keepdim=True))[:, None]
    field = random_field(count)
    return field.with_points(torch.cat([triangle, triangle + inward], dim=1))


@pytest.mark.parametrize(("kind", "share"), [("prism", 0.9), ("random", 0.75)])
def test_the_parts_fill_most_of_the_whole_and_nothing_else(kind, share):
    field = prism_field() if kind == "prism" else random_field(40)
    parts = halve(field.points, torch.zeros(len(field)))
    assert parts.shape == (len(field), 2, *field.points.shape[1:])
    both = random_field(2 * len(field), points=field.points.shape[1]).with_points(parts.flatten(0, 1))
    volumes = hull_volumes(both).reshape(-1, 2)
    assert volumes.sum() > share * hull_volumes(field).sum()
    # points within a twentieth of the extent of the cut belong to both parts, so those may share that much
    assert (volumes.sum(axis=1) < 1.3 * hull_volumes(field)).all()
    assert (volumes.max(axis=1) < hull_volumes(field)).all()
    assert (volumes.min(axis=1) > 0).all()
    corners = parts[0].flatten(0, 1).numpy()
    assert inside_union(field.select(torch.tensor([0])), corners, margin=1e-9).all()


@pytest.mark.parametrize("overlap", [0.0, 0.05])
def test_triangles_are_cut_through_the_middle_of_their_longest_edge(overlap):
    triangle = torch.tensor([[[0, 0, 0], [4, 0, 0], [1, 1, 0]]]).double()
    ((left, right),) = halve(triangle, torch.tensor([overlap], dtype=torch.float64)).tolist()
    np.testing.assert_allclose(left, [[1, 1, 0], [0, 0, 0], [2 + overlap, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(right, [[1, 1, 0], [2 - overlap, 0, 0], [4, 0, 0]], atol=1e-12)


def test_overlapping_parts_reach_into_each_other():
    field = prism_field(5)
    apart, over = (halve(field.points, torch.full((5,), overlap)) for overlap in (0.0, 0.5))
    template = random_field(10)
    first, second = (hull_volumes(template.with_points(some.flatten(0, 1))).sum() for some in (apart, over))
    assert second > 1.02 * first
    assert np.isfinite(over.numpy()).all()
