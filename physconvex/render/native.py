"""The kernel's C++ source as a loaded library: compiled on first use with the system's compiler, then kept."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

__all__ = ["SOURCES", "KernelUnavailable", "cache_folder", "compiled", "load_library"]

SOURCES = Path(__file__).with_name("cpu")
COMPILERS = ("c++", "g++", "clang++")
# No result may be infinite or NaN by design, which lets minima and maxima become single instructions.
FLAGS = (
    "-std=c++17", "-O3", "-march=native", "-fPIC", "-shared", "-pthread", "-fopenmp-simd",
    "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-ffinite-math-only",
)  # fmt: skip
COMPILE_SECONDS = 300
POINTER: Any = ctypes.c_void_p


class KernelUnavailable(RuntimeError):
    """The kernel cannot be compiled or loaded here; the message says why."""


def cache_folder() -> Path:
    """Where compiled kernels are kept: $PHYSCONVEX_CACHE, else `physconvex` in the user's cache folder."""
    given = os.environ.get("PHYSCONVEX_CACHE")
    if given:
        return Path(given)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "physconvex"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "physconvex"


@cache
def load_library() -> ctypes.CDLL:
    """The library with its functions' types declared.

    Raises:
        KernelUnavailable: no compiler, or it failed.
    """
    return _declared(ctypes.CDLL(str(compiled(SOURCES))))


def compiled(folder: Path, *, include: Sequence[Path] = ()) -> Path:
    """Path of the library of a folder's `kernel.cpp`, for these flags, this compiler and this processor.

    Args:
        include: further folders of headers.

    Raises:
        KernelUnavailable: no compiler, it failed, or the cache cannot be written.
    """
    compiler = _compiler()
    folders = (folder, *include)
    sources = [path.read_bytes() for one in folders for path in sorted(one.iterdir()) if path.suffix in (".cpp", ".h")]
    key = [*sources, " ".join(FLAGS).encode(), compiler.encode(), _processor()]
    name = hashlib.sha256(b"\0".join(key)).hexdigest()[:24]
    library = cache_folder() / f"kernel-{name}.so"
    if library.is_file():
        return library
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as scratch:
            made = Path(scratch) / library.name
            headers = [f"-I{one}" for one in include]
            _run([compiler, *FLAGS, *headers, str(folder / "kernel.cpp"), "-o", str(made)])
            made.replace(library)  # in one step, so that two processes may do this at once
    except OSError as error:
        raise KernelUnavailable(f"{library.parent}: cannot be written: {error.strerror}") from None
    return library


def _compiler() -> str:
    """Path of the first compiler found; $CXX goes before the usual names."""
    for name in (os.environ.get("CXX"), *COMPILERS):
        found = shutil.which(name) if name else None
        if found:
            return found
    raise KernelUnavailable(f"no C++ compiler found (looked for $CXX, {', '.join(COMPILERS)})")


def _run(command: list[str]) -> None:
    """Run a compiler."""
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=COMPILE_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        raise KernelUnavailable(f"{command[0]} did not end within {COMPILE_SECONDS} s") from None
    if result.returncode:
        raise KernelUnavailable(f"{command[0]} failed:\n{result.stderr.strip()[-2000:]}")


def _processor() -> bytes:
    """What the compiler's -march=native depends on: a home folder may be shared by unlike machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    told = [line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))]
    return "\n".join([platform.machine(), platform.processor(), *dict.fromkeys(told)]).encode()


class Scene(ctypes.Structure):
    """`struct Scene` of cpu/arithmetic.h."""

    _fields_ = (
        *((name, ctypes.c_int32) for name in ("width", "height", "polygons", "threads")),
        *((name, POINTER) for name in ("coordinates", "starts", "lines", "sharpness", "opacity", "features")),
    )


def _declared(library: ctypes.CDLL) -> ctypes.CDLL:
    """Declare the functions of cpu/kernel.cpp."""
    scene: Any = ctypes.POINTER(Scene)
    count: Any = ctypes.c_int32
    for name, result, arguments in (
        ("pc_plan", POINTER, [scene]),
        ("pc_free", None, [POINTER]),
        ("pc_hulls", None, [count] * 3 + [POINTER] * 4),
        ("pc_blend", None, [scene, POINTER] + [POINTER] * 3),
        ("pc_gradient", None, [scene, POINTER] + [POINTER] * 9),
        ("pc_tangent", None, [scene, POINTER, count] + [POINTER] * 7),
    ):
        function = getattr(library, name)
        function.argtypes, function.restype = arguments, result
    return library
