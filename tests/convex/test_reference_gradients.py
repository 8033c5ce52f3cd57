"""Gradients of the plain rasteriser against central differences in float64."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from physconvex.convex import ConvexField
from physconvex.render import View, render
from tests.convex.fields import random_field
from tests.convex.scenes import camera, hard_case

STEP = 1e-6  # the error of a central difference is then about 1e-10 by rounding and far less by curvature
STEP_OF = {"tiny": 1e-8, "edge_on": 1e-8}  # whose images change within a short way

# values → (field, view); each argument is one that gradients are asked for
NAMES = ("points", "smoothness", "sharpness", "opacity", "harmonics", "twist", "focal", "principal", "distortion")


def scene(field: ConvexField, view: View, **values: Tensor) -> tuple[ConvexField, View]:
    changed = {name: value for name, value in values.items() if hasattr(field, name)}
    seen = {name: value for name, value in values.items() if name in ("focal", "principal", "distortion")}
    view = replace(view, **seen)
    return replace(field, **changed), view.moved(values["twist"]) if "twist" in values else view


def inputs(field: ConvexField, view: View) -> dict[str, Tensor]:
    twist = torch.zeros(6, dtype=torch.float64)
    return {
        name: twist if name == "twist" else getattr(field if hasattr(field, name) else view, name) for name in NAMES
    }


def loss(field: ConvexField, view: View) -> Tensor:
    image = render(field, view, backend="reference", background=torch.tensor([0.3, 0.6, 0.1]))
    outputs = torch.cat([image.colour, image.alpha[..., None], image.weighted_depth[..., None]], dim=-1)
    weights = torch.randn(outputs.shape, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
    return (weights * outputs).sum()


def directional(function: Callable[[Tensor], Tensor], at: Tensor, direction: Tensor, step: float) -> Tensor:
    return (function(at + step * direction) - function(at - step * direction)) / (2 * step)


@pytest.mark.parametrize("case", ["plain", "overlapping", "near", "huge", "tiny", "edge_on"])
@pytest.mark.parametrize("points", [4, 7])
def test_gradients_of_field_and_camera(case: str, points: int) -> None:
    field = random_field(6, points=points, seed=4) if case == "plain" else hard_case(case, points, seed=2)
    view = View.of(replace(camera(16, 12), k1=0.05, k2=-0.02), torch.float64)
    values = inputs(field, view)
    leaves = {name: value.clone().requires_grad_() for name, value in values.items()}
    loss(*scene(field, view, **leaves)).backward()
    generator = torch.Generator().manual_seed(1)
    for name in NAMES:
        direction = torch.randn(values[name].shape, generator=generator, dtype=torch.float64)

        def at(value: Tensor, name: str = name) -> Tensor:
            return loss(*scene(field, view, **(values | {name: value})))

        expected = directional(at, values[name], direction, STEP_OF.get(case, STEP))
        found = (leaves[name].grad * direction).sum()
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6, msg=lambda text, name=name: f"{name}: {text}")
        assert name != "opacity" or abs(float(found)) > 1e-3
