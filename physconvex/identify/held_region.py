"""The held part of a rest geometry: its held vertices and the cells between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from physconvex.mesh import FACE_CORNERS
from physconvex.numerics import closest_points

_NEAR = 12  # held triangles with the nearest centres, to which the distance of a point is computed


@dataclass(frozen=True, eq=False)
class HeldRegion:
    """Held vertices among those of a reference geometry.

    Attributes:
        vertices: of the reference [m], shape [R, 3].
        held: indices of the held ones, shape [H].
        triangles: corners [m] of the reference's triangles, or faces of its tetrahedra, between held vertices,
            shape [F, 3, 3].
        tets: corners [m] of its tetrahedra between held vertices, shape [E, 4, 3].
    """

    vertices: Float[np.ndarray, "R 3"]
    held: Int[np.ndarray, " H"]
    triangles: Float[np.ndarray, "F 3 3"]
    tets: Float[np.ndarray, "E 4 3"]

    @classmethod
    def of(
        cls, vertices: Float[np.ndarray, "R 3"], held: Int[np.ndarray, " H"], cells: Int[np.ndarray, "E k"] | None
    ) -> HeldRegion:
        """From vertices [m], the indices of those that are held, and tetrahedra [E, 4] or triangles [E, 3]."""
        cells = np.zeros((0, 3), np.int64) if cells is None else cells
        faces = cells[:, FACE_CORNERS].reshape(-1, 3) if cells.shape[1] == 4 else cells
        marked = np.isin(np.arange(len(vertices)), held)
        within = cells[marked[cells].all(1)] if cells.shape[1] == 4 else np.zeros((0, 4), np.int64)
        return cls(vertices, held, vertices[faces[marked[faces].all(1)]], vertices[within])

    def holds(self, points: Float[np.ndarray, "P 3"], *, reach: float) -> Bool[np.ndarray, " P"]:
        """Which points are held: nearest to a held vertex, and in the region or at most `reach` [m] away from it.

        If no triangle has three held vertices, these are the points nearest to the held vertices.
        """
        if len(self.held) == 0:
            return np.zeros(len(points), bool)
        if len(self.triangles) == 0:
            marked = np.zeros(len(points), bool)
            marked[cKDTree(points).query(self.vertices[self.held])[1]] = True
            return marked
        near = np.isin(cKDTree(self.vertices).query(points)[1], self.held)
        return near & ((self._distance(points) <= reach) | self._inside(points))

    def _distance(self, points: np.ndarray) -> np.ndarray:
        """Distance to the triangles [m]."""
        count = min(_NEAR, len(self.triangles))
        index = cKDTree(self.triangles.mean(1)).query(points, k=[*range(1, count + 1)])[1]
        feet = closest_points(self.triangles[index], points[:, None])
        return np.linalg.norm(points[:, None] - feet, axis=-1).min(1)

    def _inside(self, points: np.ndarray) -> np.ndarray:
        """Whether points are in one of the tetrahedra."""
        inside = np.zeros(len(points), bool)
        for corners in self.tets:
            edges = np.linalg.solve((corners[1:] - corners[0]).T, (points - corners[0]).T)
            inside |= (edges >= 0).all(0) & (edges.sum(0) <= 1)
        return inside
