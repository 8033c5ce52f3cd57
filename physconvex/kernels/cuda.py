"""CUDA texts compiled by NVRTC, which torch's CUDA builds carry, and run on tensors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor

from physconvex.kernels.build import KernelUnavailable

__all__ = ["launch"]


def launch(source: str, name: str, *, grid: tuple[int, int], threads: int, arguments: Sequence[Tensor | int]) -> None:
    """Run the kernel of that name in a text, which is compiled on first use for each device.

    Args:
        source: the text.
        name: of the kernel.
        grid: blocks along two axes.
        threads: of each block.
        arguments: tensors of one CUDA device, which stand for their addresses, and numbers.

    Raises:
        KernelUnavailable: tensors that are not on a CUDA device, or a torch that cannot compile for it.
    """
    device = next(value.device for value in arguments if isinstance(value, Tensor))
    if device.type != "cuda":
        raise KernelUnavailable(f"the CUDA kernel was given tensors on {device}; move all of them to a CUDA device")
    with torch.cuda.device(device):
        kernel = _compiled(source, name, device.index or 0)
        kernel(grid=(*grid, 1), block=(threads, 1, 1), args=list(arguments))


@cache
def _compiled(source: str, name: str, device: int) -> Any:
    compile_kernel = getattr(torch.cuda, "_compile_kernel", None)
    if compile_kernel is None:
        raise KernelUnavailable("this torch has no torch.cuda._compile_kernel (it came with 2.9)")
    with torch.cuda.device(device):
        return compile_kernel(source, name)
