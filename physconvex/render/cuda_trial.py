"""Test of the CUDA kernel on a device before its first use: a small scene is compared with the reference."""

from __future__ import annotations

import warnings
from functools import cache

import torch
from torch import Tensor
from torch.autograd import forward_ad

from physconvex.convex import ConvexField
from physconvex.io import look_at
from physconvex.kernels import KernelUnavailable
from physconvex.render.cuda import composite_cuda, planar_hulls_cuda
from physconvex.render.directions import load_forward_mode
from physconvex.render.hull import planar_hulls
from physconvex.render.projection import project_field
from physconvex.render.reference import composite_reference
from physconvex.render.view import View

_CONVEXES, _SIZE = 300, (37, 21)  # more than one round of candidates in a tile, and truncated tiles
_IMAGE, _GRADIENT = 1e-3, 1e-2  # largest differences relative to the largest value


@cache
def cuda_draws_rightly(device: torch.device) -> bool:
    """Whether the kernel reproduces image and gradients of the reference on a device; warns once if not."""
    try:
        with torch.inference_mode(False), torch.enable_grad():  # whatever the caller has switched off
            wrong = _differences(device)
    except (KernelUnavailable, RuntimeError) as error:
        wrong = str(error) or type(error).__name__
    if wrong:
        message = f"drawing on {device} with plain torch, which is slow: the CUDA kernel is not used ({wrong})"
        warnings.warn(message, RuntimeWarning, stacklevel=5)
    return not wrong


def _differences(device: torch.device) -> str:
    """The differences, in words; empty if there are none."""
    field = _scene()
    camera = look_at((0.0, -2.0, 0.3), (0.0, 0.0, 0.0), width=_SIZE[0], height=_SIZE[1], vertical_field_of_view=0.7)
    load_forward_mode()
    cpu = torch.device("cpu")
    found = []
    for place, composite, hulls in (
        (cpu, composite_reference, planar_hulls),
        (device, composite_cuda, planar_hulls_cuda),
    ):
        leaves = field.to(place).map(lambda tensor: tensor.clone().requires_grad_())
        view = View.of(camera, torch.float32, device=place)
        layers = composite(project_field(leaves, view, hulls=hulls), view.pixel_coordinates())
        loss = layers.features.square().sum() + layers.transmittance.square().sum()
        gradients = torch.autograd.grad(loss, list(leaves.tensors()), allow_unused=True, materialize_grads=True)
        with forward_ad.dual_level():
            dual = leaves.map(lambda tensor: forward_ad.make_dual(tensor.detach(), tensor.detach()))
            image = composite(project_field(dual, view, hulls=hulls), view.pixel_coordinates())
            tangents = [forward_ad.unpack_dual(tensor).tangent for tensor in (image.features, image.transmittance)]
        drawn = (layers.features, layers.transmittance, *gradients, *tangents)
        found.append([tensor.detach().cpu() for tensor in drawn])
    for number, (expected, got) in enumerate(zip(*found, strict=True)):
        limit = _IMAGE if number < 2 else _GRADIENT
        if not (got - expected).abs().amax() <= limit * expected.abs().amax():  # NaN is no agreement
            return f"{'a trial picture is' if number < 2 else 'its derivatives are'} not the reference's"
    return ""


def _scene() -> ConvexField:
    generator = torch.Generator().manual_seed(5)

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=generator)

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(_CONVEXES, generator=generator)

    points = 0.3 * normal(_CONVEXES, 1, 3) + 0.1 * normal(_CONVEXES, 6, 3)
    return ConvexField(points, uniform(30, 120), uniform(0.5, 2), uniform(0.3, 0.95), 0.3 * normal(_CONVEXES, 4, 3))
