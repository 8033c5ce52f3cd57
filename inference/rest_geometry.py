"""The body that moves in a capture: stated by it, given apart, or reconstructed from its first frames."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from inference.reconstruction import RESULT, Reconstruction, reconstruct
from inference.reconstruction_views import sides_in_words
from inference.settings import ReconstructOptions
from physconvex import InputError
from physconvex.io import Capture, read_mesh
from physconvex.mesh import enclosed_volume, with_merged_vertices

_LOG = logging.getLogger("physconvex")
RECONSTRUCTION = "reconstruction"  # folder of the reconstruction, in that of the results


def with_rest_geometry(
    capture: Capture,
    *,
    body: Path | None = None,
    out: Path | None = None,
    options: ReconstructOptions | None = None,
    on_stage: Callable[[str, bool], None] | None = None,
) -> Capture:
    """The capture with a rest geometry, see `rest_geometry_of`."""
    return rest_geometry_of(capture, body=body, out=out, options=options, on_stage=on_stage)[0]


def rest_geometry_of(
    capture: Capture,
    *,
    body: Path | None = None,
    out: Path | None = None,
    options: ReconstructOptions | None = None,
    on_stage: Callable[[str, bool], None] | None = None,
) -> tuple[Capture, Reconstruction | None]:
    """The capture with a rest geometry, and the reconstruction that it is from, if it is from one.

    Args:
        capture: from a folder.
        body: mesh file of the closed surface at t = 0 [m], which takes the place of the capture's own.
        out: folder of the results; a reconstruction is stored in it and continues from there.
        options: of the reconstruction.
        on_stage: called before a reconstruction, with the name "reconstruction" and whether it is read from disk.

    Raises:
        InputError: `body` cannot be read or is not closed; a held part whose vertices are those of another mesh; a
            capture without geometry whose first frames do not show the body from all around.
    """
    if body is not None:
        return _with_body(capture, _closed(body)), None
    if capture.mesh() is not None or capture.tets() is not None:
        return capture, None
    if len(capture.cameras) < 2:
        raise InputError(
            f"{capture.folder}: no rest geometry, and {len(capture.cameras)} camera(s) to find it from; add mesh.obj, "
            ".ply or .glb of the closed surface at t = 0 (or name it as body), or a picture of frame 0 from more "
            "sides: CAMERA.png with CAMERA_mask.png or alpha, and its camera in capture.json"
            f"{sides_in_words(capture.cameras)}"
        )
    folder = None if out is None else out / RECONSTRUCTION
    if on_stage is not None:
        on_stage("reconstruction", folder is not None and (folder / RESULT).exists())
    found = reconstruct(capture.folder, out=folder, options=options)
    if found.body is None:
        raise InputError(
            f"{capture.folder}: no rest geometry, and the silhouettes of frame 0 share no point in space. "
            f"{' '.join(found.warnings)} Or give the closed surface as body"
        )
    _LOG.info("rest geometry: %.4g m³ from %d views", found.body.volume, len(found.training))
    return _with_body(capture, found.body), found


def _closed(path: Path) -> trimesh.Trimesh:
    mesh = read_mesh(path)
    vertices, faces = with_merged_vertices(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces))
    if enclosed_volume(vertices, faces) is None:
        raise InputError(f"body: {path} is not a closed, outward oriented surface; expected one, such as body.ply")
    return mesh


def _with_body(capture: Capture, body: trimesh.Trimesh) -> Capture:
    boundary = capture.boundary()
    if boundary is not None and boundary.clamped_vertices is not None:
        raise InputError(
            f"{capture.folder}: boundary.npz holds vertices of another mesh; state the held part as clamped_box"
        )
    return replace(capture, body=body)
