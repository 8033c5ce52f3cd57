"""The plain rasteriser: closed forms, invariances, hard cases."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.convex import ConvexField, coefficients_of_colour
from physconvex.io import Camera, look_at
from physconvex.render import RenderedImage, View, project_field, reference, render
from tests.convex.fields import cube, random_field
from tests.convex.scenes import HARD_CASES, camera, hard_case


def draw(field: ConvexField, view: Camera | View, **options) -> RenderedImage:
    return render(field, view, backend="reference", **options)


def test_one_cube_has_the_occupancy_colour_and_depth_of_the_formula() -> None:
    front = look_at((0, -3, 0), (0, 0, 0), width=21, height=15, vertical_field_of_view=0.9)
    colour = torch.tensor([[0.9, 0.2, 0.1]], dtype=torch.float64)
    field = replace(cube(0.5), harmonics=coefficients_of_colour(colour, degree=0))
    image = draw(field, front, background=torch.tensor([0.0, 0.5, 1.0]))
    # The near face, 2.5 m away, is the hull. Distances are those on the plane at unit distance times the depth 3 m.
    columns, rows = np.meshgrid(np.arange(21) + 0.5 - 10.5, np.arange(15) + 0.5 - 7.5)
    u, v = columns / front.fl_x, rows / front.fl_y
    distances = 3 * np.stack([u - 0.2, -u - 0.2, v - 0.2, -v - 0.2])
    alpha = 0.9 / (1 + np.exp(40 * distances).sum(axis=0))  # β = 1, α = 40 / m
    alpha[alpha < 1 / 255] = 0
    np.testing.assert_allclose(image.alpha, alpha, atol=1e-12)
    expected = alpha[..., None] * colour[0].numpy() + (1 - alpha[..., None]) * [0.0, 0.5, 1.0]
    np.testing.assert_allclose(image.colour, expected, atol=1e-12)
    np.testing.assert_allclose(image.depth[alpha > 0], 3.0, atol=1e-12)
    assert image.depth[0, 0].isinf() and ((image.convex == 0).numpy() == (alpha > 0)).all()


def test_nearer_convexes_hide_those_behind() -> None:
    points = torch.cat([cube(0.3).points, cube(0.3).points + torch.tensor([0.0, 1.0, 0.0])])
    double = ConvexField(points, *(torch.cat([v, v]) for v in cube().tensors()[1:]))
    front = look_at((0, -3, 0), (0, 0, 0), width=3, height=3, vertical_field_of_view=0.02)
    for order, nearest in (([0, 1], 0), ([1, 0], 1)):
        image = draw(double.select(torch.tensor(order)), front)
        opacity = 0.9 / (1 + 4 * np.exp(-40 * np.array([0.3 * 3 / 2.7, 0.3 * 4 / 3.7])))  # both at their middle
        assert image.convex[1, 1] == nearest
        np.testing.assert_allclose(image.alpha[1, 1], 1 - (1 - opacity[0]) * (1 - opacity[1]), atol=1e-6)
        weights = np.array([opacity[0], (1 - opacity[0]) * opacity[1]])
        np.testing.assert_allclose(image.weighted_depth[1, 1], weights @ [3, 4], atol=1e-6)


def test_the_look_does_not_depend_on_resolution_nor_on_the_unit_of_length() -> None:
    field, view = random_field(6), camera()
    once = draw(field, view)
    fine = draw(field, view.resized(3 * view.w, 3 * view.h))
    torch.testing.assert_close(fine.colour[1::3, 1::3], once.colour)  # the middle one of 3 × 3 looks the same way
    matrix = view.transform_matrix.copy()
    matrix[:3, 3] *= 10
    larger = ConvexField(10 * field.points, field.smoothness / 10, *field.tensors()[2:])
    torch.testing.assert_close(draw(larger, replace(view, transform_matrix=matrix)).colour, once.colour)


def test_neither_the_order_of_convexes_nor_blocks_change_the_image(monkeypatch: pytest.MonkeyPatch) -> None:
    field, view = random_field(12, seed=1), camera(40, 35)
    shuffle = torch.randperm(12)
    first, second = draw(field, view), draw(field.select(shuffle), view)
    torch.testing.assert_close(first.colour, second.colour)
    kept = second.convex >= 0
    assert torch.equal(shuffle[second.convex[kept]], first.convex[kept]) and kept.any()
    monkeypatch.setattr(reference, "BLOCK", 7)
    torch.testing.assert_close(draw(field, view).colour, first.colour)


def test_a_point_is_drawn_where_the_camera_projects_it_also_with_distortion() -> None:
    view = replace(camera(60, 50), k1=-1.5, k2=1.0)
    target = np.array([0.25, 0.3, 0.35])
    small = cube(0.06).with_points(cube(0.06).points + torch.as_tensor(target))
    alpha = draw(small, view).alpha.numpy()
    columns, rows = np.meshgrid(np.arange(60) + 0.5, np.arange(50) + 0.5)
    middle = np.array([(alpha * columns).sum(), (alpha * rows).sum()]) / alpha.sum()
    expected, straight = (some.project(target[None])[0][0] for some in (view, replace(view, k1=0.0, k2=0.0)))
    assert np.linalg.norm(expected - straight) > 1.0
    # a cube seen obliquely is not symmetric about its middle: a few per cent of its 5 pixels
    assert np.linalg.norm(middle - expected) < 0.3
    coordinates = View.of(view, torch.float64).pixel_coordinates().numpy()
    local = view.rays()[1] @ view.rotation
    np.testing.assert_allclose(coordinates, local[..., :2] / -local[..., 2:] * [1, -1], atol=1e-9)


def test_behind_the_camera_nothing_is_drawn_and_gradients_are_zero() -> None:
    field = hard_case("behind")
    points = field.points.clone().requires_grad_()
    view = camera()
    image = draw(field.with_points(points), view)
    assert (image.alpha == 0).all() and (image.colour == 1).all() and (image.convex == -1).all()
    image.colour.sum().backward()
    assert (points.grad == 0).all()


def test_what_crosses_the_near_plane_is_cut_off_exactly() -> None:
    """A box through the camera, and its part beyond the plane as a convex of its own, have the same outline."""
    front = View.of(look_at((0, -1, 0), (0, 0, 0), width=8, height=8, vertical_field_of_view=1.2), torch.float64)
    box = cube(0.5).points * torch.tensor([0.4, 3.0, 0.2])
    beyond = box.clone()
    beyond[..., 1] = box[..., 1].clamp(min=-1 + 0.1)  # all corners nearer than the plane move onto it
    outlines = []
    for points in (box, beyond):
        lines = project_field(cube().with_points(points), front, near=0.1).lines
        lines = lines / lines[:, :2].norm(dim=1, keepdim=True)
        outlines.append(sorted(lines.round(decimals=9).add(0.0).tolist()))
    np.testing.assert_allclose(outlines[0], outlines[1], atol=1e-8)
    assert len(outlines[0]) == 4


def test_seen_edge_on_a_convex_is_a_thin_line_not_nothing() -> None:
    """A plate in the plane of view: without a rule it would have no lines, or two without ends."""
    front = look_at((0, -3, 0), (0, 0, 0), width=33, height=33, vertical_field_of_view=0.7)
    plate = cube(0.5).with_points(cube(0.5).points * torch.tensor([0.0, 1.0, 1.0], dtype=torch.float64))
    hard = replace(plate, smoothness=plate.smoothness * 1000)
    alpha = draw(hard, front).alpha
    rows = (16.5 + np.array([-0.5, 0.5]) * front.fl_y / 2.5).round().astype(int)
    assert (alpha[rows[0] + 1 : rows[1] - 1, 16] > 0.89).all()
    assert (alpha[: rows[0] - 1] == 0).all() and (alpha[:, :16] == 0).all() and (alpha[:, 17:] == 0).all()
    speck = cube(1e-7)
    assert draw(replace(speck, smoothness=speck.smoothness * 1000), front).alpha[16, 16] > 0.8


@pytest.mark.parametrize("name", HARD_CASES)
def test_hard_cases_stay_finite_with_their_gradients(name: str) -> None:
    for points in (4, 12):
        field = hard_case(name, points)
        leaves = [tensor.clone().requires_grad_() for tensor in field.tensors()]
        image = draw(ConvexField(*leaves), camera())
        (image.colour.sum() + image.weighted_depth.sum()).backward()
        assert image.colour.isfinite().all() and all(leaf.grad.isfinite().all() for leaf in leaves)
        assert (image.alpha.max() > 0) == (name != "behind")


def test_backgrounds() -> None:
    field, view = random_field(4), camera()
    whole = torch.rand(view.h, view.w, 3, dtype=torch.float64).requires_grad_()
    image = draw(field, view, background=whole)
    image.colour.sum().backward()
    torch.testing.assert_close(whole.grad, (1 - image.alpha)[..., None].expand(-1, -1, 3))
    torch.testing.assert_close(
        draw(field, view).colour - draw(field, view, background=torch.zeros(3)).colour, whole.grad
    )
    with pytest.raises(InputError, match="background"):
        draw(field, view, background=torch.zeros(view.w, view.h, 3))
    with pytest.raises(InputError, match="near"):
        draw(field, view, near=0.0)
    with pytest.raises(InputError, match=r"a view of torch.float32 on cpu for a field of torch.float64"):
        draw(field, View.of(view))


def test_an_empty_field_shows_the_background() -> None:
    nothing = random_field(2).select(torch.zeros(2, dtype=torch.bool))
    image = draw(nothing, camera(), background=torch.tensor([0.1, 0.2, 0.3]))
    torch.testing.assert_close(image.colour[3, 4], torch.tensor([0.1, 0.2, 0.3]).double())
