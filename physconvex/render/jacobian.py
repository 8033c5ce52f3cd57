"""Derivatives of all pixels with respect to a few parameters, by forward mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.convex import ConvexField
from physconvex.errors import InputError
from physconvex.render.compiled import composite_kernel, composite_tangents
from physconvex.render.cuda import composite_cuda, composite_tangents_cuda
from physconvex.render.directions import slopes
from physconvex.render.projection import NEAR, PolygonPlan, Splats
from physconvex.render.rasterize import Backend, implementation
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
    """Derivatives of the image of a scene, for all parameters together.

    The kernels share the exponentials among parameters (on a CUDA device among eight): further parameters cost little.

    Args:
        scene: the field and the view as a differentiable function of the parameters.
        background, near, backend: as for `render`; the background does not depend on the parameters.

    Raises:
        InputError: no parameters, or not one row of them.
    """
    if parameters.ndim != 1 or not len(parameters):
        raise InputError(f"parameters: got shape {tuple(parameters.shape)}; expected [P] with P ≥ 1")
    parameters = parameters.detach()
    directions = torch.eye(len(parameters), device=parameters.device).to(parameters)
    with torch.no_grad():
        field, view = scene(parameters)
        hulls, composite = implementation(field.points, backend)
        plan = PolygonPlan.of(field, view, near=near, hulls=hulls)
        splats = plan.splats(field, view)

        def parts(at: Tensor) -> tuple[Tensor, ...]:
            field, view = scene(at)
            return (view.pixel_coordinates(), *plan.splats(field, view).differentiable())

        if composite in _IN_ONE_PASS:
            found = slopes(parts, parameters, directions)
            tangents = [tuple(None if part is None else part[k] for part in found) for k in range(len(parameters))]
            features, transmittance = _IN_ONE_PASS[composite](splats, view.pixel_coordinates(), tangents)
        else:
            layers = composite(splats, view.pixel_coordinates())
            still = (layers.features, layers.transmittance)

            def blended(at: Tensor) -> tuple[Tensor, ...]:
                first, *rest = parts(at)
                layers = composite(Splats(splats.convex, splats.starts, *rest), first)
                return layers.features, layers.transmittance

            found = slopes(blended, parameters, directions)
            features, transmittance = (
                value.new_zeros(len(parameters), *value.shape) if one is None else one
                for value, one in zip(still, found, strict=True)
            )
    background = features.new_ones(3) if background is None else background.to(features)
    colour = features[..., :3] + transmittance[..., None] * background
    return ImageJacobian(colour, -transmittance, features[..., 3])
