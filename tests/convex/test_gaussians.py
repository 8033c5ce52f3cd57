"""The Gaussians that convexes are compared with (benchmarks/gaussians.py): their kernel against plain torch."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest
import torch
from torch import Tensor

from physconvex.convex import view_colours
from physconvex.render import View
from tests.convex.agreement import assert_agrees
from tests.convex.scenes import camera

SOURCE = Path(__file__).parents[2] / "benchmarks" / "gaussians.py"


@pytest.fixture(scope="module")
def gaussians() -> ModuleType:
    spec = importlib.util.spec_from_file_location("gaussians", SOURCE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def blended(module: ModuleType, scene, view: View) -> tuple[Tensor, Tensor]:
    """The definition: all Gaussians at all pixels."""
    scene, view = module.Gaussians(*(tensor.double() for tensor in scene.tensors())), view.to(torch.float64)
    local = view.local(scene.centres)
    order = local.detach()[:, 2].argsort()
    places, conics = module._projected(scene.select(order), local[order], view)
    directions = torch.nn.functional.normalize(scene.centres - view.position, dim=1)
    features = torch.cat([view_colours(scene.harmonics, directions), local[:, 2:]], dim=1)[order]
    rows, columns = torch.meshgrid(torch.arange(view.height) + 0.5, torch.arange(view.width) + 0.5, indexing="ij")
    x, y = columns[..., None] - places[:, 0], rows[..., None] - places[:, 1]
    a, b, c = conics.T
    alpha = torch.sigmoid(scene.logit_opacity)[order] * torch.exp(-0.5 * (a * x * x + 2 * b * x * y + c * y * y))
    alpha = alpha.clamp(max=0.99)
    alpha = torch.where(alpha < 1 / 255, 0.0, alpha)
    before = torch.cumprod(torch.cat([torch.ones_like(alpha[..., :1]), 1 - alpha[..., :-1]], dim=-1), dim=-1)
    alpha = torch.where(before < 1e-4, 0.0, alpha)
    return (alpha * before) @ features, (1 - alpha).prod(dim=-1)


def test_image_and_gradients_are_those_of_the_definition(gaussians: ModuleType) -> None:
    rng = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=rng)

    scene = gaussians.Gaussians(
        0.2 * normal(30, 3), -3 + 0.5 * normal(30, 3), normal(30, 4), normal(30), 0.3 * normal(30, 16, 3)
    ).leaves()
    view, weight = View.of(camera(50, 37)), normal(37, 50, 5)
    found, expected = gaussians.blend_gaussians(scene, view)[0], blended(gaussians, scene, view)
    gradients = []
    for features, transmittance in (found, expected):
        loss = (features * weight[..., :4]).sum() + (transmittance * weight[..., 4]).sum()
        gradients.append(torch.autograd.grad(loss, scene.tensors()))
    assert expected[1].detach().min() < 0.5
    assert_agrees(found[0], expected[0], relative=1e-5, name="features")
    assert_agrees(found[1], expected[1], relative=1e-5, name="transmittance")
    for one, other in zip(*gradients, strict=True):
        assert_agrees(one, other, relative=1e-4)


def test_rotations_and_quaternions_are_inverse(gaussians: ModuleType) -> None:
    quaternions = torch.randn((20, 4), generator=torch.Generator().manual_seed(1))
    turns = gaussians.rotation_matrices(quaternions)
    assert torch.allclose(turns @ turns.mT, torch.eye(3).expand(20, 3, 3), atol=1e-6)
    assert torch.allclose(gaussians.rotation_matrices(gaussians.quaternions_of(turns)), turns, atol=1e-6)
