"""Ways to composite the same polygons, compared with the reference: image and gradients."""

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from physconvex.convex import ConvexField
from physconvex.render import Splats, View, composite_reference, project_field
from physconvex.render.directions import Directions, load_forward_mode
from physconvex.render.reference import Layers
from tests.convex.agreement import assert_agrees
from tests.convex.scenes import camera

ROUNDING = 2.0**-24  # of float32

Inputs = tuple[Tensor, ...]  # coordinates, lines, sharpness, opacity, features


def polygons(field: ConvexField, width: int = 37, height: int = 21) -> tuple[Splats, Inputs]:
    """What is drawn, and its differentiable part, rounded to float32 so that both start from the same numbers."""
    view = View.of(replace(camera(width, height), k1=0.1), torch.float64)
    splats = project_field(field, view)
    inputs = (view.pixel_coordinates(), *splats.differentiable())
    return splats, tuple(tensor.float() for tensor in inputs)


def layers(splats: Splats, inputs: Inputs, composite) -> Layers:
    coordinates, *polygons = inputs
    return composite(Splats(splats.convex, splats.starts, *polygons), coordinates)


def weights(shape: torch.Size) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(11), dtype=torch.float64)


def rounding(splats: Splats, inputs: Inputs) -> float:
    """Relative tolerance of float32 against float64."""
    # s_h is a sum of terms as large as these, each rounded; what it makes of the image is of the same size
    return ROUNDING * max(300.0, float(inputs[1].abs().amax() if len(splats) else 0))


def compare_composites(
    splats: Splats, inputs: Inputs, composite: Callable[[Splats, Tensor], Layers], tolerance: float
) -> None:
    """In float32 against the reference in float64."""
    leaves = [[t.to(kind).clone().requires_grad_() for t in inputs] for kind in (torch.float64, torch.float32)]
    expected = layers(splats, tuple(leaves[0]), composite_reference)
    found = layers(splats, tuple(leaves[1]), composite)
    assert found.features.dtype == torch.float32
    for name in ("features", "transmittance"):
        assert_agrees(getattr(found, name), getattr(expected, name), relative=tolerance, name=name)
    # where two weigh nearly the same, either may be named
    assert (found.heaviest == expected.heaviest).float().mean() > 0.999

    gradients, floor = [], 0.0
    for image, leaf in zip((expected, found), leaves, strict=True):
        features, transmittance = weights(image.features.shape), weights(image.transmittance.shape)
        # of convexes whose edges are all out of sight nothing is left but what float32 cannot tell from zero
        floor = ROUNDING**2 * float(features.abs().sum() + transmittance.abs().sum())
        loss = (features * image.features).sum() + (transmittance * image.transmittance).sum()
        gradients.append(torch.autograd.grad(loss, leaf, allow_unused=True, materialize_grads=True))
    names = ("coordinates", "lines", "sharpness", "opacity", "features")
    for name, reference, kernel in zip(names, *gradients, strict=True):
        assert_agrees(kernel, reference, relative=10 * tolerance, name=name, floor=floor)


def compare_tangents(
    splats: Splats,
    inputs: Inputs,
    tangents: Callable[[Splats, Tensor, Directions], tuple[Tensor, Tensor]],
    tolerance: float,
    *,
    count: int = 2,
) -> None:
    """Derivatives in `count` directions in float32 against the reference's in float64."""
    load_forward_mode()
    directions: list[tuple[Tensor | None, ...]] = [(None, inputs[1], None, None, None)]
    for place in range(1, count):
        generator = torch.Generator().manual_seed(place)
        directions.append(
            tuple(1e-2 * torch.randn(t.shape, generator=generator).to(t) * t.abs().mean() for t in inputs)
        )
    d_features, d_transmittance = tangents(Splats(splats.convex, splats.starts, *inputs[1:]), inputs[0], directions)

    def image(*values: Tensor) -> tuple[Tensor, Tensor]:
        drawn = layers(splats, values, composite_reference)
        return drawn.features, drawn.transmittance

    for place, direction in enumerate(directions):
        filled = tuple(
            (torch.zeros_like(t) if d is None else d).double() for t, d in zip(inputs, direction, strict=True)
        )
        _, expected = torch.func.jvp(image, tuple(t.double() for t in inputs), filled)
        for found, wanted in zip((d_features[place], d_transmittance[place]), expected, strict=True):
            floor = ROUNDING**2 * max(float(part.abs().max()) if part.numel() else 0.0 for part in filled)
            assert_agrees(found, wanted, relative=10 * tolerance, name=f"direction {place}", floor=floor)
