"""Images of convex fields."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import torch
from jaxtyping import Float, Int
from torch import Tensor

from physconvex.convex import ConvexField
from physconvex.errors import InputError
from physconvex.io import Camera
from physconvex.kernels import KernelUnavailable
from physconvex.render.compiled import RENDER_KERNEL, composite_kernel, planar_hulls_kernel
from physconvex.render.cuda import composite_cuda, planar_hulls_cuda
from physconvex.render.cuda_trial import cuda_draws_rightly
from physconvex.render.hull import Hulls, planar_hulls
from physconvex.render.projection import NEAR, Splats, project_field
from physconvex.render.reference import Layers, composite_reference
from physconvex.render.view import View

Backend = Literal["auto", "kernel", "cuda", "reference"]


@dataclass(frozen=True, eq=False)
class RenderedImage:
    """Image of a camera.

    Attributes:
        colour: before the background, shape [H, W, 3], linear in the field's colours, 0 to 1 where those are.
        alpha: hidden share of the background, shape [H, W].
        weighted_depth: Σ_i w_i d_i, the depth along the viewing direction times alpha, shape [H, W], metres.
        convex: index of the convex with the greatest weight, −1 without any, shape [H, W].
    """

    colour: Float[Tensor, "H W 3"]
    alpha: Float[Tensor, "H W"]
    weighted_depth: Float[Tensor, "H W"]
    convex: Int[Tensor, "H W"]

    @property
    def depth(self) -> Float[Tensor, "H W"]:
        """Mean visible depth [m]; infinite where nothing is visible."""
        seen = self.alpha > 0
        return torch.where(seen, self.weighted_depth / torch.where(seen, self.alpha, 1.0), torch.inf)


Composite = Callable[[Splats, Tensor], Layers]


def implementation(tensor: Tensor, backend: Backend = "auto") -> tuple[Callable[[Tensor], Hulls], Composite]:
    """The functions that find hulls and blend polygons for tensors like this one, see `render`."""
    if backend == "cuda" or (backend == "auto" and _is_fast_on(tensor)):
        return planar_hulls_cuda, composite_cuda
    if _uses_kernel(tensor, backend):
        return planar_hulls_kernel, composite_kernel
    return planar_hulls, composite_reference


def splat(field: ConvexField, view: View, *, near: float = NEAR, backend: Backend = "auto") -> tuple[Splats, Composite]:
    """The polygons of a field, and the function that blends them, by the chosen implementation, see `render`."""
    hulls, composite = implementation(field.points, backend)
    return project_field(field, view, near=near, hulls=hulls), composite


def _is_fast_on(tensor: Tensor) -> bool:
    """Whether the CUDA kernel can draw such tensors correctly."""
    return tensor.device.type == "cuda" and tensor.dtype == torch.float32 and cuda_draws_rightly(tensor.device)


def _uses_kernel(tensor: Tensor, backend: Backend) -> bool:
    """Whether a backend means the kernel for tensors like this one; warns if it is unavailable.

    Raises:
        KernelUnavailable: it is requested and unavailable.
        InputError: no such backend.
    """
    if backend not in get_args(Backend):
        raise InputError(f"backend: got {backend!r}; expected one of {', '.join(get_args(Backend))}")
    if backend == "auto" and tensor.dtype == torch.float32 and tensor.device.type == "cpu":
        try:
            _ = RENDER_KERNEL.library
        except KernelUnavailable as error:
            warnings.warn(f"drawing with plain torch, which is slow: {error}", RuntimeWarning, stacklevel=4)
            return False
        return True
    return backend == "kernel"


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
        near: everything nearer than this is clipped [m].
        backend: `reference` is the definition in plain torch; `kernel` computes the same in float32 on the CPU and
            needs a C++ compiler; `cuda` computes it on a CUDA device; `auto` takes the kernel of the device for float32
            if it is available (on a CUDA device: if it draws a small test scene like the reference), else it warns and
            takes the reference.

    Raises:
        InputError: a background of another shape, `near` not positive, no such backend, a view of another type.
        KernelUnavailable: `backend="kernel"` if it cannot be compiled.
    """
    view = View.of(camera, field.points.dtype, device=field.points.device) if isinstance(camera, Camera) else camera
    if (view.focal.dtype, view.focal.device) != (field.points.dtype, field.points.device):
        kinds = [f"{tensor.dtype} on {tensor.device}" for tensor in (view.focal, field.points)]
        raise InputError(f"camera: got a view of {kinds[0]} for a field of {kinds[1]}; convert one with .to()")
    if near <= 0:
        raise InputError(f"near: got {near}; expected a positive distance [m]")
    background = field.points.new_ones(3) if background is None else background.to(field.points)
    if background.shape not in ((3,), (view.height, view.width, 3)):
        raise InputError(
            f"background: got shape {tuple(background.shape)}; expected [3] or [{view.height}, {view.width}, 3]"
        )
    splats, composite = splat(field, view, near=near, backend=backend)
    layers = composite(splats, view.pixel_coordinates())
    colour = layers.features[..., :3] + layers.transmittance[..., None] * background
    convex = torch.cat([splats.convex, splats.convex.new_tensor([-1])])[layers.heaviest]
    return RenderedImage(colour, 1 - layers.transmittance, layers.features[..., 3], convex)
