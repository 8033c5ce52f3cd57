"""The triangles that bound a body, which points of other bodies must not cross."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from physconvex.errors import InputError
from physconvex.mesh import TetMesh

_QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])  # of a quadratic face


@dataclass(frozen=True)
class Shell:
    """A closed surface of triangles, counter-clockwise from outside.

    Attributes:
        points: rest positions of the vertices [m], shape [V, 3].
        faces: shape [F, 3].

    Raises:
        InputError: wrong shapes, indices out of range, or a surface that is open or turned inside out.
    """

    points: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]

    def __post_init__(self) -> None:
        points, faces = np.asarray(self.points, dtype=np.float64), np.asarray(self.faces, dtype=np.int64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(f"shell.points: got shape {points.shape}; expected finite [V, 3] in metres")
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces) or faces.min() < 0 or faces.max() >= len(points):
            raise InputError(
                f"shell.faces: got shape {faces.shape}; expected [F, 3], indices of {len(points)} vertices"
            )
        corners = points[faces] - points.mean(0)
        volume = float(np.linalg.det(corners).sum()) / 6
        if not volume > 0:
            raise InputError(f"shell: its faces enclose {volume:.3g} m³; expected a closed surface, normals outwards")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "faces", faces)

    @classmethod
    def of_mesh(cls, mesh: TetMesh) -> Shell:
        """The boundary of a tetrahedral mesh; every face of a quadratic one is split into four."""
        faces = mesh.boundary_faces
        if mesh.order == 2:
            faces = faces[:, _QUARTERS].reshape(-1, 3)
        used, faces = np.unique(faces, return_inverse=True)
        return cls(mesh.vertices[used], faces.reshape(-1, 3))
