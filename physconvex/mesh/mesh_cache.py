"""Meshes kept on disk: fTetWild's results differ from run to run, and a resumed program needs the same mesh."""

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

_GENERATION = 4  # of the meshers: increase it with every change of a mesher or of their choice
Surface = tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]


def cached_mesh(surface: Surface, settings: object) -> TetMesh | None:
    """The stored mesh of the same surface with the same settings on this machine, if there is one."""
    return _read(_path(surface, settings))


def cached_or_made(surface: Surface, settings: object, make: Callable[[], TetMesh]) -> TetMesh:
    """The mesh of `cached_mesh`, else a new one, which is stored.

    Processes that generate it at the same time all get that of the first. If the cache is not writable, the mesh is
    only generated.
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
    """A stored mesh; None if it is missing or truncated."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return TetMesh(archive["vertices"], archive["tets"])
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None
