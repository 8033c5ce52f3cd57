"""Points and surfaces carried by a tetrahedral mesh."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from physconvex.errors import InputError
from physconvex.mesh.elements import shape_gradients, shape_values
from physconvex.mesh.tet_mesh import FACE_CORNERS, TetMesh
from physconvex.numerics import closest_points

# Faces tried per point (nearest centres first), pairs of both handled at once, how far outside (in barycentric
# coordinates) still counts as inside, and elements tried first.
CANDIDATES, BLOCK, TOLERANCE, NEAREST = 32, 2_000_000, -1e-9, 6

Places = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""What `locate` returns."""


@dataclass(frozen=True)
class Embedding:
    """Points as combinations of the nodes of one element each.

    Attributes:
        elements: element that carries each point, shape [P].
        weights: shape functions of that element at the point, shape [P, 4] or [P, 10]; each row sums to one.
        nodes: the nodes the weights belong to, shape [P, 4] or [P, 10].
        node_count: nodes of the mesh.
        max_distance: distance of the outermost point from the mesh [m] (0 if all are inside). Points outside move with
            the nearest point of the mesh, and with the mean deformation gradient of its element about it.
    """

    elements: Int[np.ndarray, " P"]
    weights: Float[np.ndarray, "P n"]
    nodes: Int[np.ndarray, "P n"]
    node_count: int
    max_distance: float = 0.0

    @classmethod
    def of_points(cls, mesh: TetMesh, points: Float[np.ndarray, "P 3"]) -> Embedding:
        """Find the element that contains each point, else the nearest one.

        Args:
            mesh: the mesh at rest.
            points: rest positions [m], shape [P, 3].

        Raises:
            InputError: `points` is not a finite [P, 3] array.
        """
        points = np.asarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(f"points: got shape {points.shape}; expected finite [P, 3] in metres")
        return cls.at_places(mesh, locate(mesh, points))

    @classmethod
    def at_places(cls, mesh: TetMesh, places: Places) -> Embedding:
        """The points that `locate` has found."""
        elements, barycentric, anchors, distance = places
        return cls(
            elements=elements,
            weights=continued_shape_values(barycentric, anchors, distance > 0, mesh.order),
            nodes=mesh.tets[elements],
            node_count=len(mesh.vertices),
            max_distance=float(distance.max(initial=0.0)),
        )

    @cached_property
    def matrix(self) -> csr_matrix:
        """Sparse interpolation matrix, shape [P, V]."""
        count, width = self.weights.shape
        rows = np.arange(0, count * width + 1, width)
        return csr_matrix((self.weights.ravel(), self.nodes.ravel(), rows), shape=(count, self.node_count))

    def apply(self, positions: Float[np.ndarray, "*B V c"]) -> Float[np.ndarray, "*B P c"]:
        """Positions (or any nodal field) of the points for given nodal values.

        Args:
            positions: nodal values, shape [..., V, C], for example positions [T, V, 3] in metres.

        Raises:
            InputError: the number of nodes is not that of the mesh.
        """
        values = np.asarray(positions)
        if values.ndim < 2 or values.shape[-2] != self.node_count:
            raise InputError(f"positions: got shape {values.shape}; expected [..., {self.node_count}, C]")
        columns = np.moveaxis(values, -2, 0).reshape(self.node_count, -1)
        result = self.matrix @ columns
        return np.moveaxis(result.reshape(-1, *values.shape[:-2], values.shape[-1]), 0, -2)


def sample_interior(
    mesh: TetMesh, count: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "P 3"], Float[np.ndarray, " P"]]:
    """Points spread uniformly over the volume, and the volume each stands for.

    Systematic sampling: every element gets its share of the points up to one, so that the points are spread more evenly
    than independent draws.

    Args:
        mesh: the body.
        count: number of points P.
        rng: source of randomness.

    Returns:
        Points [m], shape [P, 3], and volume weights [m³], shape [P], whose sum is the volume of the mesh.

    Raises:
        InputError: `count` is not positive.
    """
    if count < 1:
        raise InputError(f"count: got {count}; expected at least one point")
    cumulative = np.cumsum(mesh.element_volumes)
    levels = (np.arange(count) + rng.random(count)) / count * cumulative[-1]
    elements = np.minimum(np.searchsorted(cumulative, levels, side="right"), len(cumulative) - 1)
    barycentric = rng.exponential(size=(count, 4))
    barycentric /= barycentric.sum(axis=1, keepdims=True)
    points = np.einsum("pk,pka->pa", barycentric, mesh.vertices[mesh.corner_tets[elements]])
    return points, np.full(count, mesh.volume / count)


def continued_shape_values(barycentric: np.ndarray, anchors: np.ndarray, outside: np.ndarray, order: int) -> np.ndarray:
    """Shape functions [P, n] at points inside; outside, extrapolation from the anchors by the element's mean gradient.

    Plain extrapolation of a quadratic element throws far points away: its shape functions grow with the square of the
    distance. The mean gradient, which is the one at the centre, still reproduces every affine map, and the
    extrapolation is continuous at the element's surface.
    """
    values = shape_values(anchors, order)
    away = (barycentric - anchors)[outside]
    centre = np.full((1, barycentric.shape[1]), 1 / barycentric.shape[1])
    values[outside] += away @ shape_gradients(centre, order)[0].T
    return values


def locate(mesh: TetMesh, points: np.ndarray) -> Places:
    """Location of every point in the mesh.

    Returns:
        Its element [P], its barycentric coordinates there [P, 4], those of the nearest point of the mesh [P, 4], and
        the distance between the two [m], shape [P].
    """
    points, rows = np.unique(points, axis=0, return_inverse=True)  # hulls repeat and share corners
    corners = mesh.vertices[mesh.corner_tets]
    inverse = _inverse_edges(corners)
    elements, depth = _deepest(corners, inverse, points)
    outside = np.flatnonzero(depth < TOLERANCE)
    nearest, distance = points.copy(), np.zeros(len(points))
    for block in np.array_split(outside, 1 + len(outside) * 2 * CANDIDATES // BLOCK):
        if len(block):
            found = _nearest_element(mesh, corners, inverse, points[block])
            elements[block], nearest[block], distance[block] = found
    barycentric = _barycentric(corners, inverse, elements, points)
    anchors = barycentric.copy()
    anchors[outside] = _barycentric(corners, inverse, elements[outside], nearest[outside])
    rows = rows.reshape(-1)
    return elements[rows], barycentric[rows], anchors[rows], distance[rows]


def contains(mesh: TetMesh, points: Float[np.ndarray, "P 3"]) -> Bool[np.ndarray, " P"]:
    """Which points [m] lie in the mesh."""
    corners = mesh.vertices[mesh.corner_tets]
    return _deepest(corners, _inverse_edges(corners), points)[1] >= TOLERANCE


def _inverse_edges(corners: np.ndarray) -> np.ndarray:
    return np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))


def _deepest(corners: np.ndarray, inverse: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each point the element in whose ball it is deepest [P], and the depth [P], -inf outside all of them.

    Elements do not overlap, so that none is deeper than one that holds the point: most are among the nearest.
    """
    centres, every = corners.mean(axis=1), np.arange(len(corners))
    near = cKDTree(centres).query(points, k=[*range(1, min(NEAREST, len(corners)) + 1)])[1]
    depths = np.stack([_barycentric(corners, inverse, cells, points).min(axis=1) for cells in near.T], axis=1)
    best = depths.argmax(axis=1)
    elements, depth = near[np.arange(len(points)), best], depths[np.arange(len(points)), best]
    rest = np.flatnonzero(depth <= -TOLERANCE)
    reach = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1) * (1 + 1e-9)
    elements[rest], depth[rest] = 0, -np.inf
    for block in np.array_split(rest, 1 + len(rest) * CANDIDATES // BLOCK):
        near = cKDTree(points[block]).query_ball_point(centres, reach)
        if not any(near):
            continue
        cells = np.repeat(every, [len(rows) for rows in near])
        rows = block[np.concatenate([rows for rows in near if rows])]
        smallest = _barycentric(corners, inverse, cells, points[rows]).min(axis=1)
        order = np.lexsort((smallest, rows))
        last = order[np.flatnonzero(np.diff(rows[order], append=-1))]
        elements[rows[last]], depth[rows[last]] = cells[last], smallest[last]
    return elements, depth


def _barycentric(corners: np.ndarray, inverse: np.ndarray, elements: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Barycentric coordinates [..., 4] of `points` [..., 3] in `elements` [...]."""
    inner = np.einsum("...ij,...j->...i", inverse[elements], points - corners[elements, 0])
    return np.concatenate([1.0 - inner.sum(axis=-1, keepdims=True), inner], axis=-1)


def _nearest_element(
    mesh: TetMesh, corners: np.ndarray, inverse: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Element nearest to points outside the mesh, its nearest point and the distance.

    The nearest of the boundary faces whose centres are close. If several are equally near (at an edge or a corner), the
    one whose element is extrapolated least.
    """
    boundary = mesh.boundary_rows
    owner, triangles = boundary // 4, mesh.vertices[mesh.corner_tets[:, FACE_CORNERS].reshape(-1, 3)[boundary]]
    centres = triangles.mean(axis=1)
    reach = np.linalg.norm(triangles - centres[:, None], axis=2).max(axis=1)
    count = min(CANDIDATES, len(triangles))
    away, near = cKDTree(centres).query(points, k=[*range(1, count + 1)])
    rows, columns = np.nonzero(away - reach[near] <= (1 + 1e-9) * away[:, :1])  # others are farther than the first
    faces = near[rows, columns]
    feet, depth = np.full((*near.shape, 3), np.inf), np.full(near.shape, -np.inf)
    feet[rows, columns] = closest_points(triangles[faces], points[rows])
    gaps = np.linalg.norm(points[:, None] - feet, axis=-1)
    row, closest = np.arange(len(points)), gaps.argmin(axis=1)
    depth[rows, columns] = _barycentric(corners, inverse, owner[faces], points[rows]).min(axis=1)
    tied = np.linalg.norm(feet - feet[row, closest][:, None], axis=-1) <= 1e-9 * mesh.size
    best = np.where(tied, depth, -np.inf).argmax(axis=1)
    return owner[near[row, best]], feet[row, best], gaps[row, closest]
