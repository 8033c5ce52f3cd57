"""From images back to what made them, by gradients of the kernel."""

import torch

from physconvex.convex import ConvexField, FreeParameters
from physconvex.render import View, render, render_jacobian
from tests.convex.fields import random_field
from tests.convex.scenes import camera


def test_a_disturbed_field_comes_back_to_two_images_of_it() -> None:
    truth = random_field(8, seed=20, size=0.15, degree=1, dtype=torch.float32)
    views = [View.of(camera(48, 36)), View.of(camera(48, 36)).moved(torch.tensor([0.5, 0, -0.1, 0, 0.25, 0]))]
    photos = [render(truth, view).colour for view in views]
    generator = torch.Generator().manual_seed(1)
    shifted = truth.with_points(truth.points + 0.02 * torch.randn(truth.points.shape, generator=generator))
    free = FreeParameters.of(shifted)
    losses, steps = [], 60
    for step in range(steps):
        pairs = zip(views, photos, strict=True)
        loss = torch.stack([(render(free.field(), view).colour - photo).square().mean() for view, photo in pairs]).sum()
        losses.append(loss.item())
        gradients = torch.autograd.grad(loss, free.tensors())
        with torch.no_grad():  # by sign, with steps that shrink to nothing
            for tensor, gradient, rate in zip(free.tensors(), gradients, (2e-3, 0.02, 0.02, 0.02, 0.01), strict=True):
                tensor -= rate * (1 - step / steps) * gradient.sign()
    assert losses[-1] < 0.05 * losses[0]  # 13 dB
    off = [(field.points - truth.points).norm() for field in (free.field(), shifted)]
    assert off[0] < off[1]


def test_gauss_newton_finds_pose_focal_length_and_a_shift() -> None:
    """Seven unknowns from one image in a few steps, to far below a pixel (which is about 0.04 m here)."""
    field, view = random_field(6, seed=21, dtype=torch.float64), View.of(camera(32, 24), torch.float64)
    truth = torch.tensor([0.02, -0.01, 0.015, 0.01, -0.008, 0.012, 0.02], dtype=torch.float64)

    def scene(p: torch.Tensor) -> tuple[ConvexField, View]:
        moved = view.moved(p[:6])
        focal = view.focal * (1 + p[6])
        return field, View(
            view.width, view.height, focal, view.principal, moved.rotation, moved.position, view.distortion
        )

    photo = render(*scene(truth)).colour
    found = torch.zeros_like(truth)
    for _ in range(6):
        residual = (render(*scene(found)).colour - photo).flatten()
        jacobian = render_jacobian(scene, found).colour.flatten(1)
        found = found - torch.linalg.solve(jacobian @ jacobian.T, jacobian @ residual)
    assert (found - truth).abs().max() < 1e-6
