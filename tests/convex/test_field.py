"""The field, its free parameters, its half-spaces, occupancy and support function."""

import math

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.convex import (
    ConvexField,
    FreeParameters,
    half_spaces,
    hull_faces,
    inside_union,
    occupancies,
    occupancy,
)
from tests.convex.fields import cube, random_field
from tests.convex.hulls import support


def test_six_points_and_degree_three_are_69_parameters() -> None:
    assert random_field(2).parameters_per_convex == 69


@pytest.mark.parametrize(
    ("name", "shape", "message"),
    [
        ("points", (2, 2, 3), "K ≥ 3"),
        ("smoothness", (3,), "one per convex"),
        ("opacity", (2, 1), "one per convex"),
        ("harmonics", (2, 5, 3), "1, 4, 9 or 16"),
        ("harmonics", (2, 25, 3), "degree 0 to 3"),
    ],
)
@pytest.mark.wrong_types
def test_wrong_shapes_are_named(name: str, shape: tuple[int, ...], message: str) -> None:
    names = ("points", "smoothness", "sharpness", "opacity", "harmonics")
    values = dict(zip(names, random_field(2).tensors(), strict=True))
    with pytest.raises(InputError, match=message):
        ConvexField(**(values | {name: torch.ones(shape, dtype=torch.float64)}))


def test_values_out_of_range_and_mixed_types_are_refused() -> None:
    field = random_field(2)
    for name, bad in (("smoothness", 0.0), ("sharpness", -1.0), ("opacity", 1.5), ("points", math.nan)):
        values = dict(zip(("points", "smoothness", "sharpness", "opacity", "harmonics"), field.tensors(), strict=True))
        values[name] = torch.full_like(values[name], bad)
        with pytest.raises(InputError, match=name):
            ConvexField(**values).check_values()
    with pytest.raises(InputError, match="one floating type"):
        field.with_points(field.points.float())
    field.check_values()


def test_free_parameters_give_back_the_field_and_their_gradients() -> None:
    field = random_field(4)
    free = FreeParameters.of(field)
    for back, value in zip(free.field().tensors(), field.tensors(), strict=True):
        torch.testing.assert_close(back, value, rtol=1e-12, atol=0)
    free.field().opacity.sum().backward()
    torch.testing.assert_close(free.logit_opacity.grad, field.opacity * (1 - field.opacity))


def test_cube_has_six_planes_and_the_occupancy_of_the_formula() -> None:
    field = cube(0.5)
    assert len(hull_faces(field.points[0].numpy())) == 6
    positions = torch.tensor([[0.1, -0.2, 0.3], [0.5, 0.0, 0.0], [2.0, 0.0, 0.0]], dtype=torch.float64)
    distances = torch.cat([positions - 0.5, -positions - 0.5], dim=1)  # the six faces, by hand
    expected = torch.sigmoid(-torch.logsumexp(40 * distances, dim=1))
    torch.testing.assert_close(occupancy(field, positions)[:, 0], expected, rtol=1e-9, atol=1e-30)
    assert occupancy(field, positions)[0, 0] > 0.9 and occupancy(field, positions)[2, 0] < 1e-20


def test_half_spaces_hold_the_points_and_touch_them() -> None:
    for points in (4, 6, 12):
        field = random_field(5, points=points, seed=points)
        spaces = half_spaces(field)
        inside = torch.einsum("nki,nhi->nkh", field.points, spaces.normals) - spaces.offsets[:, None]
        assert inside.max() < 1e-12
        real = spaces.offsets.isfinite()
        assert (inside.amax(dim=1)[real].abs() < 1e-12).all()
        # The support function in the direction of a face is the distance of its plane (the dual description).
        for convex in range(5):
            normals = spaces.normals[convex][real[convex]]
            torch.testing.assert_close(support(field, normals)[:, convex], spaces.offsets[convex][real[convex]])


def test_flat_convex_keeps_both_sides() -> None:
    flat = torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)
    field = cube(0.5).with_points(cube(0.5).points * flat)
    with pytest.raises(InputError, match="no volume"):
        hull_faces(field.points[0].numpy())
    distances = half_spaces(field).distances(
        torch.tensor([[0.0, 0.0, 0.2], [0.0, 0.0, -0.2], [0.0, 0.0, 0.0]]).double()
    )
    # thickened by 1e-4 of half the width
    torch.testing.assert_close(distances.amax(dim=-1)[:2, 0], torch.full((2,), 0.2).double(), rtol=0, atol=2e-4)
    assert distances[2].amax().abs() < 1e-4


def test_a_triangle_counts_as_a_thin_prism() -> None:
    corners = torch.tensor([[0, 0, 0], [2, 0, 0], [0, 1, 0]]).double()
    line = corners * torch.tensor([1.0, 0, 0])
    field = random_field(2, points=3).with_points(torch.stack([corners, line]))
    where = torch.tensor([[0.3, 0.2, 0.4], [0.3, 0.2, -0.4], [0.3, 0.2, 0], [3.0, 0, 0]]).double()
    distances = half_spaces(field).distances(where)
    assert distances[0, 0].isfinite().sum() == 5
    thick = torch.tensor([0.4, 0.4, 0.0, 1 / math.sqrt(5)]).double()  # from the plane, from the oblique edge
    torch.testing.assert_close(distances.amax(dim=-1)[:, 0], thick, rtol=0, atol=3e-4)
    assert not distances.isnan().any()
    np.testing.assert_array_equal(inside_union(field, where.numpy()), [False, False, True, False])


@pytest.mark.parametrize("count", [3, 5])
def test_occupancy_gradient_against_differences(count: int) -> None:
    field = random_field(2, points=count, seed=3)
    positions = field.centres + 0.05

    def value(points: torch.Tensor, smoothness: torch.Tensor, sharpness: torch.Tensor) -> torch.Tensor:
        return occupancy(ConvexField(points, smoothness, sharpness, field.opacity, field.harmonics), positions)

    inputs = tuple(tensor.clone().requires_grad_() for tensor in field.tensors()[:3])
    assert torch.autograd.gradcheck(value, inputs, eps=1e-6, atol=1e-6, rtol=1e-4)


def test_occupancies_are_those_of_all_convexes_together() -> None:
    field = random_field(30, seed=5)
    positions = torch.cat([field.centres, field.points[:, 0]])
    each = field.opacity * occupancy(field, positions)
    greatest, union = occupancies(field, positions.numpy())
    # pairs farther apart than eight widths of the edge, e⁻⁸, are left out
    np.testing.assert_allclose(greatest, each.amax(dim=1), atol=4e-4)
    np.testing.assert_allclose(union, 1 - (1 - each).prod(dim=1), atol=30 * 4e-4)
    assert np.median(greatest) > 0.2 and union.max() <= 1


def test_select_and_types() -> None:
    field = random_field(4)
    chosen = field.select(torch.tensor([2, 0]))
    assert torch.equal(chosen.points, field.points[[2, 0]]) and len(chosen) == 2
    assert field.to(torch.float32).harmonics.dtype == torch.float32
    assert np.isclose(field.centres[1, 2], field.points[1, :, 2].mean())
