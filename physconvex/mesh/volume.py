"""The volume that a surface encloses, and meshes brought to a wanted volume."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from physconvex.mesh.quality import mean_ratios
from physconvex.mesh.tet_mesh import TetMesh, to_quadratic

__all__ = ["enclosed_volume", "with_volume"]


def enclosed_volume(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> float | None:
    """Volume inside a closed, outward oriented surface [m³]; None where it is open or inside out.

    Vertices at the same place count as one, so that a surface cut along its texture seams is closed.
    """
    _, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    forward, counts = np.unique(directed, axis=0, return_counts=True)
    backward = np.unique(directed[:, ::-1], axis=0)
    if (counts > 1).any() or len(forward) != len(backward) or (forward != backward).any():
        return None
    _, first = np.unique(index.reshape(-1), return_index=True)
    x = (vertices[first] - vertices.mean(axis=0))[faces]
    volume = float(np.linalg.det(x).sum() / 6.0)
    return volume if volume > 0 else None


def with_volume(mesh: TetMesh, volume: float, *, iterations: int = 5) -> TetMesh:
    """`mesh` with its boundary moved along the normals until it encloses `volume` [m³].

    Steps that would make an element flatter than half its previous mean ratio are shortened, so the volume
    is met as far as the elements allow.
    """
    corners = mesh.corner_tets
    nodes, tets = np.unique(corners, return_inverse=True)
    linear = TetMesh(mesh.vertices[nodes], tets.reshape(-1, 4))
    faces = linear.boundary_faces[:, :3]
    x = linear.vertices.copy()
    floor = np.minimum(0.5 * mean_ratios(x, linear.tets), 0.2)
    for _ in range(iterations):
        current = np.linalg.det(x[linear.tets[:, 1:]] - x[linear.tets[:, :1]]).sum() / 6.0
        if abs(current / volume - 1) < 1e-6:
            break
        normals = _area_normals(x, faces)
        area = np.linalg.norm(normals, axis=1)
        direction = normals / np.maximum(area, np.finfo(float).tiny)[:, None]
        step = (volume - current) / max(area.sum(), np.finfo(float).tiny)
        while np.any(mean_ratios(x + step * direction, linear.tets) < floor) and abs(step) > 1e-9 * linear.size:
            step *= 0.5
        x = x + step * direction
    moved = TetMesh(x, linear.tets)
    return to_quadratic(moved) if mesh.order == 2 else moved


def _area_normals(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Outward area vector of each node, a third of those of its faces: the gradient of the volume."""
    cross = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]]) / 6.0
    normals = np.zeros_like(x)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], cross)
    return normals
