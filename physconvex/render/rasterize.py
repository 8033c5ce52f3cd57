"""Images of convex fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from physconvex.camera import Camera
from physconvex.convex.field import ConvexField
from physconvex.errors import InputError
from physconvex.render.projection import NEAR, Splats, project
from physconvex.render.reference import Layers, composite_reference
from physconvex.render.view import View

__all__ = ["Backend", "RenderedImage", "composite", "render"]

Backend = Literal["auto", "kernel", "reference"]


@dataclass(frozen=True, eq=False)
class RenderedImage:
    """What a camera sees.

    Attributes:
        colour: before the background, shape [H, W, 3], linear in the field's colours, 0 to 1 where those are.
        alpha: share of the background that is hidden, shape [H, W].
        weighted_depth: Σ_i w_i d_i, the depth along the viewing direction times alpha, shape [H, W], metres.
        convex: index of the convex with the greatest weight, −1 where there is none, shape [H, W].
    """

    colour: Float[Tensor, "H W 3"]
    alpha: Float[Tensor, "H W"]
    weighted_depth: Float[Tensor, "H W"]
    convex: Int[Tensor, "H W"]

    @property
    def depth(self) -> Float[Tensor, "H W"]:
        """Mean depth of what is seen [m]; infinite where nothing is."""
        seen = self.alpha > 0
        return torch.where(seen, self.weighted_depth / torch.where(seen, self.alpha, 1.0), torch.inf)


def composite(splats: Splats, coordinates: Float[Tensor, "H W 2"], *, backend: Backend = "auto") -> Layers:
    """Blend polygons with the chosen implementation."""
    return composite_reference(splats, coordinates)


def render(
    field: ConvexField,
    camera: Camera | View,
    *,
    background: Float[Tensor, " 3"] | Float[Tensor, "H W 3"] | None = None,
    near: float = NEAR,
    backend: Backend = "auto",
) -> RenderedImage:
    """Draw a field, differentiable with respect to the field, the view and the background.

    Args:
        camera: a `View` for derivatives with respect to its pose, focal length or distortion.
        background: one colour or one per pixel; white if not given.
        near: what is nearer than this is cut away [m].
        backend: `reference` is the definition in plain torch; `kernel` computes the same in float32 on the CPU and
            needs a C++ compiler; `auto` takes the kernel where it can be had.

    Raises:
        InputError: a background of another shape, `near` not positive.
    """
    view = View.of(camera, field.points.dtype) if isinstance(camera, Camera) else camera
    if near <= 0:
        raise InputError(f"near: got {near}; expected a positive distance [m]")
    background = torch.ones(3).to(field.points) if background is None else background.to(field.points)
    if background.shape not in ((3,), (view.height, view.width, 3)):
        raise InputError(
            f"background: got shape {tuple(background.shape)}; expected [3] or [{view.height}, {view.width}, 3]"
        )
    splats = project(field, view, near=near)
    layers = composite(splats, view.pixel_coordinates(), backend=backend)
    colour = layers.features[..., :3] + layers.transmittance[..., None] * background
    convex = torch.cat([splats.convex, splats.convex.new_tensor([-1])])[layers.heaviest]
    return RenderedImage(colour, 1 - layers.transmittance, layers.features[..., 3], convex)
