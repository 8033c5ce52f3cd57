"""Singular values of many 3 × 3 matrices, and what flows by them, compiled."""

from __future__ import annotations

import ctypes
from functools import cache

import torch
from torch import Tensor

from physconvex.kernels.build import POINTER, SOURCES, Functions, available, loaded

__all__ = ["flow_response", "load_library", "singular_values"]


def singular_values(f: Tensor, flat: float) -> tuple[Tensor, Tensor, Tensor] | None:
    """U [..., 3, 3], σ [..., 3] from the largest on and Vᵀ [..., 3, 3] of matrices [..., 3, 3].

    None where they are of another kind than float64 on the CPU, one is not finite or has a smallest σ of less than
    `flat` times its largest one, or nothing can be compiled.
    """
    if not _compilable(f):
        return None
    f = f.contiguous()
    u, s, vt = torch.empty_like(f), f.new_empty(f.shape[:-1]), torch.empty_like(f)
    pointers = [array.data_ptr() for array in (f, u, s, vt)]
    made = load_library().pc_singular_values(s.numel() // 3, pointers[0], flat, *pointers[1:])
    return (u, s, vt) if made else None


def flow_response(
    f: Tensor, undo: Tensor, mu: Tensor, bulk: Tensor, limit: Tensor, left: float, tension: bool, flat: float
) -> tuple[Tensor, Tensor] | None:
    """Energy density [...], first Piola–Kirchhoff stress [..., 3, 3] at F of a `LogarithmicStep`.

    None as for `singular_values`, of F F_f⁻¹, or where the shapes differ.
    """
    if f.shape != undo.shape or mu.shape != f.shape[:-2] or not all(map(_compilable, (f, undo, mu, bulk, limit))):
        return None
    given = [array.contiguous() for array in (f, undo, mu, bulk, limit)]
    energy, stress = f.new_empty(mu.shape), f.new_empty(f.shape)
    pointers = [array.data_ptr() for array in (*given, energy, stress)]
    made = load_library().pc_flow_response(mu.numel(), *pointers[:5], left, int(tension), flat, *pointers[5:])
    return (energy, stress) if made else None


def _compilable(f: Tensor) -> bool:
    return f.dtype == torch.float64 and f.device.type == "cpu" and not f.requires_grad and available(load_library)


@cache
def load_library() -> ctypes.CDLL:
    """The library with its functions' types declared.

    Raises:
        KernelUnavailable: no compiler, or it failed.
    """
    number = ctypes.c_double
    functions: Functions = (
        ("pc_singular_values", ctypes.c_int32, [ctypes.c_int64, POINTER, number, *[POINTER] * 3]),
        (
            "pc_flow_response",
            ctypes.c_int32,
            [ctypes.c_int64, *[POINTER] * 5, number, ctypes.c_int32, number, *[POINTER] * 2],
        ),
    )
    return loaded(SOURCES / "principal_strains", functions)
