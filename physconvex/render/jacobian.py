"""Derivatives of all pixels with respect to a few parameters, by forward mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd import forward_ad

from physconvex.convex import ConvexField
from physconvex.errors import InputError
from physconvex.render.compiled import composite_kernel, composite_tangents
from physconvex.render.cuda import composite_cuda, composite_tangents_cuda
from physconvex.render.directions import load_forward_mode
from physconvex.render.projection import NEAR, Splats
from physconvex.render.rasterize import Backend, splat
from physconvex.render.view import View

_IN_ONE_PASS = {composite_kernel: composite_tangents, composite_cuda: composite_tangents_cuda}


@dataclass(frozen=True, eq=False)
class ImageJacobian:
    """Derivatives of a `RenderedImage` with respect to P parameters.

    Attributes:
        colour: before the given background, shape [P, H, W, 3].
        alpha: shape [P, H, W].
        weighted_depth: shape [P, H, W], metres.
    """

    colour: Float[Tensor, "P H W 3"]
    alpha: Float[Tensor, "P H W"]
    weighted_depth: Float[Tensor, "P H W"]


def render_jacobian(
    scene: Callable[[Tensor], tuple[ConvexField, View]],
    parameters: Float[Tensor, " P"],
    *,
    background: Float[Tensor, " 3"] | Float[Tensor, "H W 3"] | None = None,
    near: float = NEAR,
    backend: Backend = "auto",
) -> ImageJacobian:
    """Derivatives of the image of a scene, one forward pass of the projection and one of all pixels for each parameter.

    The kernels share the exponentials among parameters (on a CUDA device among eight): further parameters cost little.

    Args:
        scene: the field and the view as a differentiable function of the parameters.
        background, near, backend: as for `render`; the background does not depend on the parameters.

    Raises:
        InputError: no parameters, or not one row of them.
    """
    if parameters.ndim != 1 or not len(parameters):
        raise InputError(f"parameters: got shape {tuple(parameters.shape)}; expected [P] with P ≥ 1")
    load_forward_mode()
    parameters = parameters.detach()
    tangents: list[tuple[Tensor | None, ...]] = []
    with torch.no_grad():
        for direction in torch.eye(len(parameters), device=parameters.device).to(parameters):
            with forward_ad.dual_level():
                field, view = scene(forward_ad.make_dual(parameters, direction))
                splats, composite = splat(field, view, near=near, backend=backend)
                duals: tuple[Tensor, ...] = (view.pixel_coordinates(), *splats.differentiable())
                if composite not in _IN_ONE_PASS:
                    layers = composite(splats, duals[0])
                    duals = (layers.features, layers.transmittance)
                pairs = [forward_ad.unpack_dual(tensor) for tensor in duals]
                values = [pair.primal for pair in pairs]
                tangents.append(tuple(pair.tangent for pair in pairs))
        if composite in _IN_ONE_PASS:
            primal = Splats(splats.convex, splats.starts, *values[1:])
            features, transmittance = _IN_ONE_PASS[composite](primal, values[0], tangents)
        else:
            parts = zip(*tangents, strict=True)
            features, transmittance = (
                torch.stack([torch.zeros_like(value) if one is None else one for one in some])
                for value, some in zip(values, parts, strict=True)
            )
    background = features.new_ones(3) if background is None else background.to(features)
    colour = features[..., :3] + transmittance[..., None] * background
    return ImageJacobian(colour, -transmittance, features[..., 3])
