"""Meshes kept on disk: those of fTetWild differ from run to run, and a program that goes on needs the one it had."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Float, Int

from physconvex import __version__
from physconvex.kernels import cache_folder
from physconvex.mesh.tet_mesh import TetMesh

_GENERATION = 4  # of the meshers: one more whenever they, or the choice between them, change
Surface = tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]


def cached_mesh(surface: Surface, settings: object) -> TetMesh | None:
    """The mesh that was kept of the same surface with the same settings on this machine, if there is one."""
    return _read(_path(surface, settings))


def cached_or_made(surface: Surface, settings: object, make: Callable[[], TetMesh]) -> TetMesh:
    """The mesh that is `cached_mesh`, else a new one, which is kept.

    Processes that make it at the same time all get that of the first. Where the cache cannot be written the mesh is
    just made.
    """
    path = _path(surface, settings)
    found = _read(path)
    if found is not None:
        return found
    mesh = make()
    partial = path.with_name(f".{path.stem}.{os.getpid()}.npz")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(partial, vertices=mesh.vertices, tets=mesh.tets)
        other = _read(path)
        if other is None:
            os.replace(partial, path)
        return mesh if other is None else other
    except OSError:
        return mesh
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def _path(surface: Surface, settings: object) -> Path:
    digest = hashlib.sha256(repr((__version__, _GENERATION, settings)).encode())
    for array in surface:
        digest.update(np.ascontiguousarray(array).tobytes())
    return cache_folder() / "meshes" / f"{digest.hexdigest()[:32]}.npz"


def _read(path: Path) -> TetMesh | None:
    """A kept mesh; None where there is none, or one cut short."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return TetMesh(archive["vertices"], archive["tets"])
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None
