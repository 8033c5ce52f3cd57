"""The renderer's kernel on the CPU as a loaded library."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

from physconvex.kernels import FLAGS, POINTER, SOURCES, Functions, loaded

__all__ = ["RENDER_FLAGS", "Scene", "load_library"]

# No result may be infinite or NaN by design, which lets minima and maxima become single instructions.
RENDER_FLAGS = (*FLAGS, "-pthread", "-fopenmp-simd", "-fno-signed-zeros", "-ffinite-math-only")


class Scene(ctypes.Structure):
    """`struct Scene` of cpu/arithmetic.h."""

    _fields_ = (
        *((name, ctypes.c_int32) for name in ("width", "height", "polygons", "threads")),
        *((name, POINTER) for name in ("coordinates", "starts", "lines", "sharpness", "opacity", "features")),
    )


@cache
def load_library() -> ctypes.CDLL:
    """The library with its functions' types declared.

    Raises:
        KernelUnavailable: no compiler, or it failed.
    """
    scene: Any = ctypes.POINTER(Scene)
    count: Any = ctypes.c_int32
    functions: Functions = (
        ("pc_plan", POINTER, [scene]),
        ("pc_free", None, [POINTER]),
        ("pc_hulls", None, [count] * 3 + [POINTER] * 4),
        ("pc_blend", None, [scene, POINTER] + [POINTER] * 3),
        ("pc_gradient", None, [scene, POINTER] + [POINTER] * 9),
        ("pc_tangent", None, [scene, POINTER, count] + [POINTER] * 7),
    )
    return loaded(SOURCES / "render", functions, flags=RENDER_FLAGS)
