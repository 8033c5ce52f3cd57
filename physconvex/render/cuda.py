"""The kernel for CUDA devices as torch functions; see `physconvex.kernels.cuda`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from physconvex.kernels import SOURCES, launch
from physconvex.render.directions import Directions, stacked
from physconvex.render.hull import Hulls
from physconvex.render.projection import Splats
from physconvex.render.reference import Layers

FUNCTIONS = ("blend", "gradient", "tangent", "hulls")
SIDE, BLOCK, FEATURES, DIRECTIONS = 16, 256, 4, 8


def composite_cuda(splats: Splats, coordinates: Float[Tensor, "H W 2"]) -> Layers:
    """Result of `composite_reference`, in float32 on a CUDA device.

    Differentiable once, backward and forward, with respect to the coordinates and all of `Splats.differentiable`. Sums
    over pixels have no fixed order, so that gradients differ by rounding from run to run.

    Raises:
        KernelUnavailable: tensors that are not on a CUDA device, or no compiler for it.
    """
    features, transmittance, heaviest = _Composite.apply(splats.starts, coordinates, *splats.differentiable())
    return Layers(features, transmittance, heaviest.long())


def composite_tangents_cuda(
    splats: Splats, coordinates: Float[Tensor, "H W 2"], directions: Directions
) -> tuple[Float[Tensor, "P H W 4"], Float[Tensor, "P H W"]]:
    """Result of `composite_tangents`, in one pass over the image for every eight directions.

    Raises:
        KernelUnavailable: as for `composite_cuda`.
    """
    return _Scene(splats.starts, (coordinates, *splats.differentiable())).tangents(directions)


def planar_hulls_cuda(points: Float[Tensor, "N C 2"]) -> Hulls:
    """Result of `planar_hulls`, one thread for each hull.

    Raises:
        KernelUnavailable: as for `composite_cuda`.
    """
    given = points.detach().double().contiguous()
    count, candidates = given.shape[:2]
    order, number = given.new_empty((count, candidates), dtype=torch.long), given.new_empty(count, dtype=torch.long)
    width = given.new_empty(count)
    if count:
        _launch("hulls", (-(-count // BLOCK), 1), [count, candidates, given, order, number, width])
    return Hulls(order, number, width)


@cache
def render_source(name: str) -> str:
    """The CUDA text that holds one of `FUNCTIONS`."""
    if name != "hulls":
        return (SOURCES / "render_cuda" / "kernel.cu").read_text(encoding="utf-8")
    # the source shared with the CPU, and its launch
    parts = [SOURCES / "render" / "hulls.h", SOURCES / "render_cuda" / "hulls.cu"]
    return "#define DEVICE __device__\n" + "".join(part.read_text(encoding="utf-8") for part in parts)


def _launch(name: str, grid: tuple[int, int], arguments: Sequence[Tensor | int]) -> None:
    """Run one of `FUNCTIONS` with `BLOCK` threads in each block."""
    launch(render_source(name), name, grid=grid, threads=BLOCK, arguments=arguments)


class _Scene:
    """Inputs and launch geometry of the functions.

    Attributes:
        inputs: coordinates, lines, sharpness, opacity, features.
        size: height, width [pixels].
        tiles: blocks along the width and the height.
        arguments: the first of every function of `kernel.cu`.
    """

    def __init__(self, starts: Tensor, inputs: Sequence[Tensor]) -> None:
        self.inputs = [tensor.detach().float().contiguous() for tensor in inputs]
        coordinates, *polygons = self.inputs
        height, width = coordinates.shape[:2]
        self.size = (height, width)
        self.tiles = -(-width // SIDE), -(-height // SIDE)
        self.arguments: list[Tensor | int] = [
            width,
            height,
            len(starts) - 1,
            coordinates,
            starts.int().contiguous(),
            *polygons,
        ]

    def tangents(self, directions: Directions) -> tuple[Tensor, Tensor]:
        """Derivatives of features and transmittance."""
        new, count, lines = self.inputs[0].new_empty, len(directions), len(self.inputs[1])
        out = new((count, *self.size, FEATURES)), new((count, *self.size))
        given = stacked(directions, self.inputs)
        for first in range(0, count, DIRECTIONS):
            parts = [tensor[first : first + DIRECTIONS] for tensor in (*given, *out)]
            _launch("tangent", self.tiles, [*self.arguments, len(parts[0]), lines, *parts])
        return out


class _Composite(torch.autograd.Function):
    """Blending as a function of coordinates, lines, sharpness, opacity, features."""

    @staticmethod
    def forward(ctx: Any, starts: Tensor, *inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        ctx.scene, ctx.kinds = _Scene(starts, inputs), [tensor.dtype for tensor in inputs]
        new, size = ctx.scene.inputs[0].new_empty, ctx.scene.size
        out = new((*size, FEATURES)), new(size), new(size, dtype=torch.int32)
        _launch("blend", ctx.scene.tiles, [*ctx.scene.arguments, *out])
        ctx.save_for_backward(*out[:2])
        ctx.mark_non_differentiable(out[2])
        return out[0].to(inputs[0]), out[1].to(inputs[0]), out[2]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        found = [torch.zeros_like(tensor) for tensor in ctx.scene.inputs]
        upward = [tensor.float().contiguous() for tensor in gradients[:2]]
        _launch("gradient", ctx.scene.tiles, [*ctx.scene.arguments, *ctx.saved_tensors, *upward, *found])
        return None, *(tensor.to(kind) for tensor, kind in zip(found, ctx.kinds, strict=True))

    @staticmethod
    def jvp(ctx: Any, _: Any, *tangents: Tensor | None) -> tuple[Tensor, Tensor, None]:
        features, transmittance = ctx.scene.tangents([tangents])
        return features[0].to(ctx.kinds[0]), transmittance[0].to(ctx.kinds[0]), None
