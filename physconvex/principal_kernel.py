"""The compiled singular values of many 3 × 3 matrices."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from physconvex.native import POINTER, Functions, available, loaded

__all__ = ["load_library", "singular_values"]

_SOURCES = Path(__file__).with_name("cpu")


def singular_values(f: Tensor, flat: float) -> tuple[Tensor, Tensor, Tensor] | None:
    """U [..., 3, 3], σ [..., 3] from the largest on and Vᵀ [..., 3, 3] of matrices [..., 3, 3].

    None where they are of another kind than float64 on the CPU, one is not finite or has a smallest σ of less than
    `flat` times its largest one, or nothing can be compiled.
    """
    if f.dtype != torch.float64 or f.device.type != "cpu" or f.requires_grad or not available(load_library):
        return None
    f = f.contiguous()
    u, s, vt = torch.empty_like(f), f.new_empty(f.shape[:-1]), torch.empty_like(f)
    pointers = [array.data_ptr() for array in (f, u, s, vt)]
    made = load_library().pc_singular_values(s.numel() // 3, pointers[0], flat, *pointers[1:])
    return (u, s, vt) if made else None


@cache
def load_library() -> ctypes.CDLL:
    """The library with its functions' types declared.

    Raises:
        KernelUnavailable: no compiler, or it failed.
    """
    number = ctypes.c_double
    functions: Functions = (("pc_singular_values", ctypes.c_int32, [ctypes.c_int64, POINTER, number, *[POINTER] * 3]),)
    return loaded(_SOURCES, functions)
