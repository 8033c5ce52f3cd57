"""Shapes of elements."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from physconvex.mesh import FACE_CORNERS, TetMesh
from physconvex.mesh.tet_mesh import mean_ratios


@dataclass(frozen=True)
class MeshQuality:
    """Summary of the element shapes of a mesh.

    Attributes:
        min_dihedral_deg, max_dihedral_deg: extreme angles between two faces of an element [degrees].
        min_mean_ratio: smallest `mean_ratios`, 1 for a regular tetrahedron, 0 for a flat one.
        min_volume_ratio: smallest element volume over the mean element volume.
    """

    min_dihedral_deg: float
    max_dihedral_deg: float
    min_mean_ratio: float
    min_volume_ratio: float


def dihedral_angles(vertices: Float[np.ndarray, "V 3"], tets: Int[np.ndarray, "E n"]) -> Float[np.ndarray, "E 6"]:
    """The six angles between the faces of each tetrahedron [rad]."""
    x = vertices[tets[:, :4]]
    edge_a = x[:, FACE_CORNERS[:, 1]] - x[:, FACE_CORNERS[:, 0]]
    edge_b = x[:, FACE_CORNERS[:, 2]] - x[:, FACE_CORNERS[:, 0]]
    normals = np.cross(edge_a, edge_b)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), np.finfo(float).tiny)
    i, j = np.array(list(combinations(range(4), 2))).T
    return np.arccos(np.clip(-np.einsum("eka,eka->ek", normals[:, i], normals[:, j]), -1.0, 1.0))


def mesh_quality(mesh: TetMesh) -> MeshQuality:
    """Extreme element shapes of `mesh`."""
    angles = np.degrees(dihedral_angles(mesh.vertices, mesh.tets))
    volumes = mesh.element_volumes
    return MeshQuality(
        min_dihedral_deg=float(angles.min()),
        max_dihedral_deg=float(angles.max()),
        min_mean_ratio=float(mean_ratios(mesh.vertices, mesh.tets).min()),
        min_volume_ratio=float(volumes.min() / volumes.mean()),
    )
