"""The CPU kernel as torch functions: blending, its gradient, its derivatives in a few directions."""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from physconvex.kernels import FLAGS, POINTER, SOURCES, Kernel
from physconvex.render.directions import Directions, stacked
from physconvex.render.hull import Hulls
from physconvex.render.projection import Splats
from physconvex.render.reference import Layers

FEATURES = 4
# No result is infinite or NaN by design, so that minima and maxima are single instructions.
RENDER_FLAGS = (*FLAGS, "-pthread", "-fopenmp-simd", "-fno-signed-zeros", "-ffinite-math-only")


class _Scene(ctypes.Structure):
    """`struct Scene` of sources/render/arithmetic.h."""

    _fields_ = (
        *((name, ctypes.c_int32) for name in ("width", "height", "polygons", "threads")),
        *((name, POINTER) for name in ("coordinates", "starts", "lines", "sharpness", "opacity", "features")),
    )


_SCENE: Any = ctypes.POINTER(_Scene)
_COUNT = ctypes.c_int32
RENDER_KERNEL = Kernel(
    SOURCES / "render",
    {
        "pc_plan": (POINTER, [_SCENE]),
        "pc_free": (None, [POINTER]),
        "pc_hulls": (None, [*[_COUNT] * 3, *[POINTER] * 4]),
        "pc_blend": (None, [_SCENE, *[POINTER] * 4]),
        "pc_gradient": (None, [_SCENE, *[POINTER] * 10]),
        "pc_tangent": (None, [_SCENE, POINTER, _COUNT, *[POINTER] * 7]),
    },
    flags=RENDER_FLAGS,
)


def composite_kernel(splats: Splats, coordinates: Float[Tensor, "H W 2"]) -> Layers:
    """Result of `composite_reference`, in float32 on the CPU with `torch.get_num_threads()` threads.

    Differentiable once, backward and forward, with respect to the coordinates and all of `Splats.differentiable`.

    Raises:
        KernelUnavailable: the kernel cannot be compiled here.
    """
    features, transmittance, heaviest = _Composite.apply(splats.starts, coordinates, *splats.differentiable())
    return Layers(features, transmittance, heaviest)


def composite_tangents(
    splats: Splats, coordinates: Float[Tensor, "H W 2"], directions: Directions
) -> tuple[Float[Tensor, "P H W 4"], Float[Tensor, "P H W"]]:
    """Derivatives of features and transmittance in P directions, in one pass over the image.

    Raises:
        KernelUnavailable: the kernel cannot be compiled here.
    """
    blending = _Blending(splats.starts, coordinates, *splats.differentiable())
    return blending.tangents(directions)


def planar_hulls_kernel(points: Float[Tensor, "N C 2"]) -> Hulls:
    """Result of `planar_hulls`.

    Raises:
        KernelUnavailable: the kernel cannot be compiled here.
    """
    given = points.detach().double().cpu().contiguous()
    count, candidates = given.shape[:2]
    order, number = given.new_empty((count, candidates), dtype=torch.long), given.new_empty(count, dtype=torch.long)
    width = given.new_empty(count)
    pointers = [tensor.data_ptr() for tensor in (given, order, number, width)]
    RENDER_KERNEL.library.pc_hulls(count, candidates, torch.get_num_threads(), *pointers)
    return Hulls(*(tensor.to(points.device) for tensor in (order, number, width)))


class _Blending:
    """One scene in the kernel's memory, which is freed with this object."""

    def __init__(self, starts: Int[Tensor, " M1"], coordinates: Tensor, *polygons: Tensor) -> None:
        self._library = RENDER_KERNEL.library
        self.inputs = tuple(tensor.detach().float().cpu().contiguous() for tensor in (coordinates, *polygons))
        self._starts = starts.cpu().int().contiguous()
        height, width = coordinates.shape[:2]
        coordinates, *arrays = self.inputs
        pointers = [tensor.data_ptr() for tensor in (coordinates, self._starts, *arrays)]
        self._scene = _Scene(width, height, len(starts) - 1, torch.get_num_threads(), *pointers)
        self._plan = self._library.pc_plan(ctypes.byref(self._scene))
        weakref.finalize(self, self._library.pc_free, self._plan)
        self.size = (height, width)

    def blend(self) -> tuple[Tensor, Tensor, Tensor]:
        """Features, transmittance, heaviest."""
        new = self.inputs[0].new_empty
        out = new((*self.size, FEATURES)), new(self.size), new(self.size, dtype=torch.int32)
        self._call("pc_blend", *out)
        return out

    def gradient(self, image: Sequence[Tensor], gradients: Sequence[Tensor]) -> tuple[Tensor, ...]:
        """Gradients of the inputs from features and transmittance and the gradients of those."""
        out = tuple(torch.empty_like(tensor) for tensor in self.inputs)
        given = [tensor.float().cpu().contiguous() for tensor in (*image, *gradients)]
        self._call("pc_gradient", *given, *out)
        return out

    def tangents(self, directions: Directions) -> tuple[Tensor, Tensor]:
        """Derivatives of features and transmittance."""
        still = all(direction[0] is None for direction in directions)  # the kernel then skips the derivatives of rays
        coordinates = None if still else stacked([direction[:1] for direction in directions], self.inputs[:1])[0]
        polygons = stacked([direction[1:] for direction in directions], self.inputs[1:])
        new = self.inputs[0].new_empty
        out = new((len(directions), *self.size, FEATURES)), new((len(directions), *self.size))
        self._call("pc_tangent", len(directions), coordinates, *polygons, *out)
        return out

    def _call(self, name: str, *arguments: Tensor | int | None) -> None:
        """Call a function of the library on this scene."""
        plain = [value.data_ptr() if isinstance(value, Tensor) else value for value in arguments]
        getattr(self._library, name)(ctypes.byref(self._scene), self._plan, *plain)


class _Composite(torch.autograd.Function):
    """Blending as a function of coordinates, lines, sharpness, opacity, features."""

    @staticmethod
    def forward(ctx: Any, starts: Tensor, *inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        ctx.blending = _Blending(starts, *inputs)
        features, transmittance, heaviest = ctx.blending.blend()
        out = features.to(inputs[0]), transmittance.to(inputs[0]), heaviest.to(inputs[0].device).long()
        ctx.kinds = [(tensor.device, tensor.dtype) for tensor in inputs]
        ctx.mark_non_differentiable(out[2])
        ctx.save_for_backward(*out[:2], *inputs)  # the inputs only so that torch detects changes to them
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        found = ctx.blending.gradient(ctx.saved_tensors[:2], gradients[:2])
        return None, *(tensor.to(*kind) for tensor, kind in zip(found, ctx.kinds, strict=True))

    @staticmethod
    def jvp(ctx: Any, _: Any, *tangents: Tensor | None) -> tuple[Tensor, Tensor, None]:
        features, transmittance = ctx.blending.tangents([tangents])
        return features[0].to(*ctx.kinds[0]), transmittance[0].to(*ctx.kinds[0]), None
