"""Preparation of a process for OpenGL."""

from __future__ import annotations

import ctypes
import importlib.util
from pathlib import Path


def load_triton_first() -> None:
    """Load triton's library, if it is installed, before Mesa's.

    Both bring an LLVM. With software rendering in Mesa, loading triton after it causes a segmentation fault (seen with
    triton 3.9 and Mesa 22.3), and torch loads triton for its first optimiser. The other order works.
    """
    package = importlib.util.find_spec("triton")
    for folder in (package.submodule_search_locations or ()) if package is not None else ():
        for library in sorted(Path(folder, "_C").glob("libtriton*.so")):
            ctypes.CDLL(str(library))
