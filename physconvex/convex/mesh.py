"""The hulls of a convex field as a triangle mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
import trimesh

from physconvex.convex.field import ConvexField
from physconvex.convex.hull_points import hull_triangles
from physconvex.convex.spherical_harmonics import MIDDLE, harmonic_basis
from physconvex.errors import InputError


def hull_mesh(field: ConvexField) -> trimesh.Trimesh:
    """All hulls as one mesh [m], each vertex with its convex's mean colour and opacity.

    Flat convexes, which have no hull, are omitted; the mesh is empty if all are flat.
    """
    colours = _mean_colours(field)
    vertices: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    rgba: list[np.ndarray] = []
    count = 0
    for points, colour in zip(field.points.detach().cpu().double().numpy(), colours, strict=True):
        if np.linalg.matrix_rank(points - points[0], tol=1e-9 * np.ptp(points)) < 3:
            continue
        corners, triangles = hull_triangles(points)
        faces.append(triangles + count)
        vertices.append(points[corners])
        rgba.append(np.tile(colour, (len(corners), 1)))
        count += len(corners)
    if not vertices:
        return trimesh.Trimesh()
    return trimesh.Trimesh(
        np.concatenate(vertices), np.concatenate(faces), vertex_colors=np.concatenate(rgba), process=False
    )


def write_glb(field: ConvexField, path: str | Path) -> None:
    """Write the hulls for any viewer of glTF files.

    Raises:
        InputError: no convex has a volume.
    """
    mesh = hull_mesh(field)
    if mesh.is_empty:
        raise InputError("field: no convex has a volume; there is nothing to write")
    mesh.export(Path(path), file_type="glb")


def _mean_colours(field: ConvexField) -> np.ndarray:
    """Colour averaged over directions (the first coefficient) and opacity, [N, 4] of 0 to 255."""
    up = torch.tensor([0.0, 0.0, 1.0], dtype=field.points.dtype)
    constant = harmonic_basis(up, 0)
    rgb = MIDDLE + constant * field.harmonics[:, 0].detach().cpu()
    rgba = torch.cat([rgb, field.opacity.detach().cpu()[:, None]], dim=1).clamp(0, 1)
    return (rgba * 255).round().to(torch.uint8).numpy()
