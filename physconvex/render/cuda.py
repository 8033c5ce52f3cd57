"""The kernel for CUDA devices as a torch function; compiled by NVRTC, which torch's CUDA builds carry."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from physconvex.native import KernelUnavailable
from physconvex.render.projection import Splats
from physconvex.render.reference import Layers

__all__ = ["SOURCE", "composite_cuda"]

SOURCE = Path(__file__).with_name("gpu") / "kernel.cu"
SIDE, BLOCK, FEATURES = 16, 256, 4


def composite_cuda(splats: Splats, coordinates: Float[Tensor, "H W 2"]) -> Layers:
    """What `composite_reference` computes, in float32 on a CUDA device.

    Differentiable once, backward, with respect to the coordinates and all of `Splats.differentiable`; sums over pixels
    come in no fixed order, so gradients differ by rounding from run to run.

    Raises:
        KernelUnavailable: tensors that are not on a CUDA device, or a torch that cannot compile for it.
    """
    features, transmittance, heaviest = _Composite.apply(splats.starts, coordinates, *splats.differentiable())
    return Layers(features, transmittance, heaviest.long())


@cache
def _kernel(name: str, device: int) -> Any:
    """A compiled function of the source."""
    compile_kernel = getattr(torch.cuda, "_compile_kernel", None)
    if compile_kernel is None:
        raise KernelUnavailable("this torch has no torch.cuda._compile_kernel (it came with 2.9)")
    with torch.cuda.device(device):
        return compile_kernel(SOURCE.read_text(encoding="utf-8"), name)


def _launch(name: str, grid: tuple[int, int], arguments: Sequence[Tensor | int]) -> None:
    """Run a function of the source, one block of `BLOCK` threads per tile."""
    device = next(value.device for value in arguments if isinstance(value, Tensor))
    if device.type != "cuda":
        raise KernelUnavailable(f"the CUDA kernel was given tensors on {device}; move field and view to a CUDA device")
    with torch.cuda.device(device):
        _kernel(name, device.index or 0)(grid=(*grid, 1), block=(BLOCK, 1, 1), args=list(arguments))


class _Composite(torch.autograd.Function):
    """Blending as a function of coordinates, lines, sharpness, opacity, features."""

    @staticmethod
    def forward(ctx: Any, starts: Tensor, *inputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        given = [tensor.detach().float().contiguous() for tensor in inputs]
        height, width = inputs[0].shape[:2]
        sizes = [width, height, len(starts) - 1]
        scene: list[Tensor | int] = [*sizes, given[0], starts.int().contiguous(), *given[1:]]
        new = given[0].new_empty
        out = new((height, width, FEATURES)), new((height, width)), new((height, width), dtype=torch.int32)
        ctx.grid = (-(-width // SIDE), -(-height // SIDE))
        _launch("blend", ctx.grid, [*scene, *out])
        ctx.scene, ctx.kinds = scene, [tensor.dtype for tensor in inputs]
        ctx.save_for_backward(*out[:2])
        ctx.mark_non_differentiable(out[2])
        return out[0].to(inputs[0]), out[1].to(inputs[0]), out[2]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        coordinates, _, *others = ctx.scene[3:]
        found = [torch.zeros_like(tensor) for tensor in (coordinates, *others)]
        upward = [tensor.float().contiguous() for tensor in gradients[:2]]
        _launch("gradient", ctx.grid, [*ctx.scene, *ctx.saved_tensors, *upward, *found])
        return None, *(tensor.to(kind) for tensor, kind in zip(found, ctx.kinds, strict=True))
