"""Contact at points of the surface that the mesh carries, instead of the mesh's own nodes.

Coarse meshes cut corners: their outermost nodes are off the body's surface by a good part of an element, so that they
touch early or late and at other points. Points of the surface itself, interpolated by the elements (`Embedding`), touch
as the body does for every mesh. Forces on them are distributed to the nodes by the same weights, which conserves work.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.spatial import ConvexHull, QhullError, cKDTree
from trimesh.remesh import subdivide

from physconvex.dynamics import Contact, Friction
from physconvex.errors import InputError
from physconvex.mesh import Embedding


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points that represent a surface.

    Attributes:
        points: rest positions [m], shape [S, 3].
        areas: area of the surface that each represents [m²], shape [S].

    Raises:
        InputError: shapes that do not fit together.
    """

    points: Float[np.ndarray, "S 3"]
    areas: Float[np.ndarray, " S"]

    def __post_init__(self) -> None:
        if np.shape(self.points) != (len(self.areas), 3) or not len(self.areas):
            raise InputError(
                f"surface points: got points {np.shape(self.points)} and areas {np.shape(self.areas)}; "
                "expected [S, 3] and [S], at least one"
            )

    @classmethod
    def of_triangles(
        cls, vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"], *, count: int = 1500
    ) -> SurfacePoints:
        """About `count` vertices of a surface: all corners of its convex hull, and others evenly spread.

        Triangles are split into four while there are fewer than half as many vertices.
        """
        vertices, triangles, most = np.asarray(vertices), np.asarray(triangles), count
        while len(np.unique(triangles)) < count / 2:
            vertices, triangles = subdivide(vertices, triangles)
            most = max(most, len(vertices))
        corners = vertices[triangles]
        areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        shares = np.bincount(triangles.ravel(), np.repeat(areas / 3, 3), minlength=len(vertices))
        chosen = _spread(vertices, np.flatnonzero(shares > 0), areas.sum(), most)
        nearest = cKDTree(vertices[chosen]).query(vertices)[1]
        gathered = np.bincount(nearest, shares, minlength=len(chosen))
        return cls(vertices[chosen], gathered)


def _spread(vertices: np.ndarray, used: np.ndarray, area: float, count: int) -> np.ndarray:
    """Indices of the hull's corners among the vertices in use, and of one vertex in each cell of a grid."""
    if len(used) <= count:
        return used
    cells = np.floor(vertices[used] / np.sqrt(area / count)).astype(np.int64)
    first = used[np.unique(cells, axis=0, return_index=True)[1]]
    try:
        hull = used[ConvexHull(vertices[used]).vertices]
    except QhullError:  # a flat one
        hull = used[:0]
    return np.union1d(first, hull)


@dataclass(frozen=True, eq=False, kw_only=True)
class CarriedContact(Contact):
    """The contact law at points that the nodes carry; blocks of its Hessians are those of the points.

    Attributes:
        carried: the points, by the nodes.
    """

    carried: Embedding

    @cached_property
    def _transposed(self) -> csr_matrix:
        return self.carried.matrix.T.tocsr()

    def energy_and_gradient(self, x: Float[np.ndarray, "V 3"], time: float) -> tuple[float, Float[np.ndarray, "V 3"]]:
        """Contact energy [J] and its derivative by the nodes [N]."""
        energy, gradient = super().energy_and_gradient(self.carried.matrix @ x, time)
        return energy, self._transposed @ gradient

    def freeze_friction(
        self, x: Float[np.ndarray, "V 3"], velocity: Float[np.ndarray, "V 3"], time: float
    ) -> tuple[Friction, ...]:
        """Friction on the points, linearised at node positions [m] and velocities [m/s]."""
        matrix = self.carried.matrix
        return super().freeze_friction(matrix @ x, matrix @ velocity, time)

    def friction_energy_and_gradient(
        self, frozen: tuple[Friction, ...], velocity: Float[np.ndarray, "V 3"]
    ) -> tuple[float, Float[np.ndarray, "V 3"]]:
        """Rate potential [W] and its derivative by the velocities of the nodes [N]."""
        if not frozen:
            return 0.0, np.zeros_like(velocity)
        loss, force = super().friction_energy_and_gradient(frozen, self.carried.matrix @ velocity)
        return loss, self._transposed @ force

    def hessian_blocks(self, x: Float[np.ndarray, "V 3"], time: float) -> Float[np.ndarray, "S 3 3"]:
        """Diagonal blocks of the Hessian by the points [N/m]."""
        return super().hessian_blocks(self.carried.matrix @ x, time)

    def add_to_elements(self, elements: Float[np.ndarray, "E m m"], blocks: Float[np.ndarray, "S 3 3"]) -> None:
        """Add blocks of the points to the matrices of the elements that carry them."""
        touched = np.flatnonzero(blocks.any((1, 2)))
        weights = self.carried.weights[touched]
        rows = np.einsum("sa,sij,sb->saibj", weights, blocks[touched], weights)
        np.add.at(elements, self.carried.elements[touched], rows.reshape(len(touched), *elements.shape[1:]))
