"""C++ sources as loaded libraries: compiled on first use with the system's compiler, then cached."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

SOURCES = Path(__file__).with_name("sources")
COMPILERS = ("c++", "g++", "clang++")
FLAGS = ("-std=c++17", "-O3", "-march=native", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math")
COMPILE_SECONDS = 300
POINTER: Any = ctypes.c_void_p
_LINE = 64  # bytes


class KernelUnavailable(RuntimeError):
    """The kernel cannot be compiled or loaded here; the message gives the reason."""


def cache_folder() -> Path:
    """Folder of compiled kernels: $PHYSCONVEX_CACHE, else `physconvex` in the user's cache folder."""
    given = os.environ.get("PHYSCONVEX_CACHE")
    if given:
        return Path(given)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "physconvex"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "physconvex"


def compiled(folder: Path, *, include: Sequence[Path] = (), flags: Sequence[str] = FLAGS) -> Path:
    """Path of the library of a folder's `kernel.cpp`, for these flags, this compiler and this processor.

    Args:
        folder: of the sources, that is its headers and `kernel.cpp`.
        include: further folders of headers.
        flags: of the compiler.

    Raises:
        KernelUnavailable: no source, no compiler, a failed compilation, or a cache that is not writable.
    """
    if not (folder / "kernel.cpp").is_file():
        raise KernelUnavailable(f"{folder} holds no kernel.cpp")
    compiler = _compiler()
    folders = (folder, *include)
    sources = [path.read_bytes() for one in folders for path in sorted(one.iterdir()) if path.suffix in (".cpp", ".h")]
    key = [*sources, " ".join(flags).encode(), compiler.encode(), _processor()]
    name = hashlib.sha256(b"\0".join(key)).hexdigest()[:24]
    library = cache_folder() / f"kernel-{name}.so"
    if library.is_file():
        return library
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as scratch:
            made = Path(scratch) / library.name
            headers = [f"-I{one}" for one in include]
            _run([compiler, *flags, *headers, str(folder / "kernel.cpp"), "-o", str(made)])
            made.replace(library)  # atomic, so that two processes may do this at once
    except OSError as error:
        raise KernelUnavailable(f"{library.parent}: cannot be written: {error.strerror}") from None
    return library


@dataclass(frozen=True, eq=False)
class Kernel:
    """A folder of C++ sources as a library, see `compiled`; a missing or failing compiler is tried once.

    Attributes:
        folder: of the sources.
        functions: name of each function of the library: its return type and argument types.
        include: further folders of headers.
        flags: of the compiler.
    """

    folder: Path
    functions: Mapping[str, tuple[Any, Sequence[Any]]]
    include: Sequence[Path] = ()
    flags: Sequence[str] = FLAGS

    @cached_property
    def _loaded(self) -> ctypes.CDLL | KernelUnavailable:
        try:
            library = ctypes.CDLL(str(compiled(self.folder, include=self.include, flags=self.flags)))
        except KernelUnavailable as error:
            return error
        for name, (result, arguments) in self.functions.items():
            function = getattr(library, name)
            function.argtypes, function.restype = list(arguments), result
        return library

    @property
    def available(self) -> bool:
        """Whether the library is available here."""
        return isinstance(self._loaded, ctypes.CDLL)

    @property
    def library(self) -> ctypes.CDLL:
        """The library with its functions' types declared.

        Raises:
            KernelUnavailable: it cannot be compiled.
        """
        if isinstance(self._loaded, ctypes.CDLL):
            return self._loaded
        raise KernelUnavailable(str(self._loaded))


def doubles(array: np.ndarray) -> np.ndarray:
    """An array in the kernels' format: float64, contiguous; the same array if it is already."""
    return np.ascontiguousarray(array, dtype=np.float64)


def aligned(array: np.ndarray) -> np.ndarray:
    """A contiguous copy aligned to the processor's cache lines: each wide load then takes one line."""
    room = np.empty(array.nbytes + _LINE, dtype=np.uint8)
    begin = -address(room) % _LINE
    out = room[begin : begin + array.nbytes].view(array.dtype).reshape(array.shape)
    out[...] = array
    return out


def address(array: np.ndarray) -> int:
    """Address of an array in memory."""
    return array.__array_interface__["data"][0]


def _compiler() -> str:
    """Path of the first compiler found; $CXX takes precedence over the usual names."""
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
    """Properties that the compiler's -march=native depends on: different machines may share a home folder."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    told = [line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))]
    return "\n".join([platform.machine(), platform.processor(), *dict.fromkeys(told)]).encode()
