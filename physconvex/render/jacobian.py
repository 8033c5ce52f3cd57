"""Derivatives of all pixels with respect to a handful of parameters, by forward mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd import forward_ad

from physconvex.convex.field import ConvexField
from physconvex.errors import InputError
from physconvex.render.kernel import composite_tangents
from physconvex.render.projection import NEAR, project
from physconvex.render.rasterize import Backend, composite, uses_kernel
from physconvex.render.view import View

__all__ = ["ImageJacobian", "render_jacobian"]


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

    The kernel shares the exponentials among all parameters, so one more costs little.

    Args:
        scene: the field and the view as a differentiable function of the parameters.
        background, near, backend: as for `render`; the background does not depend on the parameters.

    Raises:
        InputError: no parameters, or not one row of them.
    """
    if parameters.ndim != 1 or not len(parameters):
        raise InputError(f"parameters: got shape {tuple(parameters.shape)}; expected [P] with P ≥ 1")
    parameters = parameters.detach()
    tangents: list[tuple[Tensor | None, ...]] = []
    with torch.no_grad():
        for direction in torch.eye(len(parameters)).to(parameters):
            with forward_ad.dual_level():
                field, view = scene(forward_ad.make_dual(parameters, direction))
                splats, coordinates = project(field, view, near=near), view.pixel_coordinates()
                whole = (coordinates, *splats.differentiable())
                if not uses_kernel(coordinates, backend):
                    layers = composite(splats, coordinates, backend="reference")
                    whole = (layers.features, layers.transmittance)
                tangents.append(tuple(forward_ad.unpack_dual(tensor).tangent for tensor in whole))
                plain = [forward_ad.unpack_dual(tensor).primal for tensor in whole]
        if uses_kernel(coordinates, backend):
            primal = type(splats)(splats.convex, splats.starts, *plain[1:])
            features, transmittance = composite_tangents(primal, plain[0], tangents)
        else:
            filled = [
                [_or_zero(part, plain[place]) for part in parts]
                for place, parts in enumerate(zip(*tangents, strict=True))
            ]
            features, transmittance = (torch.stack(parts) for parts in filled)
    background = torch.ones(3).to(features) if background is None else background.to(features)
    colour = features[..., :3] + transmittance[..., None] * background
    return ImageJacobian(colour, -transmittance, features[..., 3])


def _or_zero(tangent: Tensor | None, like: Tensor) -> Tensor:
    """A tangent, zero where the tensor does not depend on the parameter."""
    return torch.zeros_like(like) if tangent is None else tangent
