"""Derivatives of all pixels by few parameters, against differences and between implementations."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.autograd import forward_ad

from physconvex import InputError
from physconvex.convex import ConvexField
from physconvex.io import look_at
from physconvex.render import View, render, render_jacobian
from physconvex.render.directions import load_forward_mode
from tests.convex.agreement import assert_agrees
from tests.convex.fields import random_field
from tests.convex.scenes import camera


def scene_of(field: ConvexField, view: View) -> Callable[[Tensor], tuple[ConvexField, View]]:
    """A shift along x, a stretch along z, sharper edges; a turn and a step of the camera, its focal length."""

    def scene(p: Tensor) -> tuple[ConvexField, View]:
        x, y, z = field.points.unbind(dim=-1)
        points = torch.stack([x + p[0], y, z * (1 + p[1])], dim=-1)
        moved = ConvexField(points, field.smoothness * torch.exp(p[2]), *field.tensors()[2:])
        turned = view.moved(torch.cat([p[3:5], p.new_zeros(2), p[4:6]]))
        focal = view.focal * (1 + p[6])
        changed = View(
            view.width, view.height, focal, view.principal, turned.rotation, turned.position, view.distortion
        )
        return moved, changed

    return scene


def test_jacobian_against_central_differences() -> None:
    scene = scene_of(random_field(5, seed=8), View.of(camera(20, 14), torch.float64))
    at, background = torch.zeros(7, dtype=torch.float64), torch.tensor([0.1, 0.5, 0.9])
    found = render_jacobian(scene, at, background=background)

    def image(p: Tensor) -> Tensor:
        drawn = render(*scene(p), background=background, backend="reference")
        return torch.cat([drawn.colour, drawn.alpha[..., None], drawn.weighted_depth[..., None]], dim=-1)

    step = 1e-6
    for place, direction in enumerate(torch.eye(7, dtype=torch.float64)):
        expected = (image(at + step * direction) - image(at - step * direction)) / (2 * step)
        columns = [found.colour[place], found.alpha[place, ..., None], found.weighted_depth[place, ..., None]]
        assert expected.abs().max() > 1e-2
        assert_agrees(torch.cat(columns, dim=-1), expected, relative=1e-5, name=f"parameter {place}")


def test_kernel_and_reference_agree() -> None:
    field, view = random_field(20, seed=9, size=0.1, dtype=torch.float32), View.of(camera(40, 30))
    at = torch.zeros(7)
    kernel = render_jacobian(scene_of(field, view), at, backend="kernel")
    double = scene_of(field.to(torch.float64), view.to(torch.float64))
    reference = render_jacobian(double, at.double(), backend="reference")
    for name in ("colour", "alpha", "weighted_depth"):
        # the projection is in float32 as well
        assert_agrees(getattr(kernel, name), getattr(reference, name), relative=1e-3, name=name)


def test_backward_and_forward_mode_agree_through_the_kernel() -> None:
    """Jᵀ w from the Jacobian equals the gradient of w · image."""
    scene = scene_of(random_field(6, seed=10, dtype=torch.float32), View.of(camera()))
    at = torch.zeros(7, requires_grad=True)
    image = render(*scene(at), backend="kernel")
    weights = torch.randn(image.colour.shape, generator=torch.Generator().manual_seed(0))
    (weights * image.colour).sum().backward()
    forward = (weights * render_jacobian(scene, at, backend="kernel").colour).flatten(1).sum(dim=1)
    assert_agrees(forward, at.grad, relative=1e-4)


@pytest.mark.wrong_types
def test_parameters_must_be_one_row() -> None:
    scene = scene_of(random_field(2), View.of(camera(), torch.float64))
    for wrong in (torch.zeros(0), torch.zeros(())):
        with pytest.raises(InputError, match="parameters"):
            render_jacobian(scene, wrong)


def test_a_lens_without_distortion_can_be_differentiated_by_it() -> None:
    load_forward_mode()
    view = View.of(look_at((0, -4, 0.5), (0, 0, 0.5), width=6, height=4, vertical_field_of_view=0.6), torch.float64)
    k1 = torch.tensor([1.0, 0.0], dtype=torch.float64)
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(torch.zeros_like(k1), k1)
        tangent = forward_ad.unpack_dual(replace(view, distortion=dual).pixel_coordinates()).tangent
    plane = view.pixel_coordinates()
    torch.testing.assert_close(tangent, -plane * plane.square().sum(dim=-1, keepdim=True))
