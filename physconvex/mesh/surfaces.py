"""Triangle surfaces: enclosed volume, closed seams, simplification."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int


def enclosed_volume(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> float | None:
    """Volume inside a closed, outward oriented surface [m³]; None if it is open or inside out.

    Vertices at the same place count as one, so that a surface split along its texture seams is closed.
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


def with_merged_vertices(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "G 3"]]:
    """The same surface with one vertex per place and without the triangles that become flat: closes texture seams."""
    vertices, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    sound = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices, faces[sound]


def with_fewer_triangles(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "G 3"]]:
    """A closed surface with about `count` triangles, by edge collapses of least quadric error.

    Garland & Heckbert 1997, as implemented in VTK, with the volume preserved. Unlike resampling this keeps thin parts.
    A surface of fewer triangles is returned unchanged.
    """
    import pyvista  # here: it loads VTK, which is slow

    vertices, faces = with_merged_vertices(vertices, faces)
    if len(faces) <= count:
        return vertices, np.ascontiguousarray(faces, dtype=np.int32)
    surface = pyvista.PolyData(vertices, np.column_stack([np.full(len(faces), 3), faces]).ravel())
    fewer = surface.decimate(1.0 - count / len(faces), volume_preservation=True)
    corners = np.asarray(fewer.faces).reshape(-1, 4)[:, 1:]
    return np.asarray(fewer.points, dtype=np.float64), np.ascontiguousarray(corners, dtype=np.int32)
