"""A surface as triangles of about equal size, each with normals at its corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyvista as pv
import trimesh
from jaxtyping import Float

NEAREST_MERGE = 1e-6  # vertices nearer than this share of the size are merged
LEAST_REDUCTION = 0.02


@dataclass(frozen=True, eq=False)
class Triangles:
    """F triangles that need not share corners.

    Attributes:
        corners: shape [F, 3, 3], metres, anticlockwise from outside.
        normals: outward unit normals at the corners, smooth over the surface, shape [F, 3, 3].
    """

    corners: Float[np.ndarray, "F 3 3"]
    normals: Float[np.ndarray, "F 3 3"]

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def areas(self) -> Float[np.ndarray, " F"]:
        """Areas [m²]."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def even_triangles(mesh: trimesh.Trimesh, count: int) -> Triangles:
    """About `count` triangles, never more: the mesh simplified by quadric edge collapse, then its largest bisected.

    The simplification leaves few triangles where the surface is flat; bisection adds those that texture needs there.
    """
    mesh = welded(mesh)
    target = max(4, round(0.7 * count))
    if len(mesh.faces) > target * (1 + LEAST_REDUCTION):
        reduced = pv.wrap(mesh).decimate(1 - target / len(mesh.faces), volume_preservation=True)
        mesh = welded(trimesh.Trimesh(reduced.points, reduced.regular_faces, process=False))
    faces = mesh.faces[mesh.area_faces > 0]
    if len(faces) > count:  # the collapse ended early
        faces = faces[np.argsort(-mesh.area_faces[mesh.area_faces > 0])[:count]]
    made = Triangles(np.array(mesh.vertices[faces]), np.array(mesh.vertex_normals[faces]))
    while len(made) < count:
        areas = made.areas
        largest = np.argsort(-areas)[: count - len(made)]
        made = _bisected(made, largest[areas[largest] > 0.5 * areas[largest[0]]])
    return made


def welded(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The bare surface; vertices that differ only by their texture coordinates are merged."""
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    size = max(float(np.ptp(vertices, axis=0).max()), np.finfo(float).tiny)
    _, first, place = np.unique(
        np.round(vertices / (NEAREST_MERGE * size)).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    faces = place.reshape(-1)[np.asarray(mesh.faces)]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return trimesh.Trimesh(vertices[first], faces[whole], process=False)


def _bisected(triangles: Triangles, which: np.ndarray) -> Triangles:
    """Those triangles halved at the middle of their longest edges."""
    corners, normals = triangles.corners[which], triangles.normals[which]
    rows = np.arange(len(which))
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).argmax(axis=1)
    order = (longest[:, None] + np.arange(3)) % 3  # the longest edge from the first to the second corner
    corners, normals = corners[rows[:, None], order], normals[rows[:, None], order]
    middle = 0.5 * (corners[:, 0] + corners[:, 1])
    upward = normals[:, 0] + normals[:, 1]
    upward /= np.maximum(np.linalg.norm(upward, axis=1, keepdims=True), 1e-12)
    return Triangles(
        _halves(triangles.corners, which, corners, middle), _halves(triangles.normals, which, normals, upward)
    )


def _halves(every: np.ndarray, which: np.ndarray, chosen: np.ndarray, between: np.ndarray) -> np.ndarray:
    """Values at the corners of the remaining triangles and of the two halves of each chosen one."""
    first = np.stack([chosen[:, 0], between, chosen[:, 2]], axis=1)
    second = np.stack([between, chosen[:, 1], chosen[:, 2]], axis=1)
    return np.concatenate([np.delete(every, which, axis=0), first, second])
