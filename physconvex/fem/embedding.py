"""Points and surfaces carried by a tetrahedral mesh."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from physconvex.errors import InputError
from physconvex.fem.elements import shape_values
from physconvex.fem.mesh import TetMesh

__all__ = ["Embedding", "sample_interior"]

# Elements tried per point, nearest centre first, and points handled at once.
CANDIDATES, CHUNK = 24, 4096


@dataclass(frozen=True)
class Embedding:
    """Points written as combinations of the nodes of one element each.

    Attributes:
        elements: element that carries each point, shape [P].
        weights: shape functions of that element at the point, shape [P, 4] or [P, 10]; each row sums to one.
        nodes: the nodes the weights belong to, shape [P, 4] or [P, 10].
        node_count: nodes of the mesh.
        max_distance: how far the outermost point lies outside the mesh [m] (0 if all are inside). Such points
            move with the linear or quadratic continuation of the nearest element's motion.
    """

    elements: Int[np.ndarray, " P"]
    weights: Float[np.ndarray, "P n"]
    nodes: Int[np.ndarray, "P n"]
    node_count: int
    max_distance: float = 0.0

    @classmethod
    def of_points(cls, mesh: TetMesh, points: Float[np.ndarray, "P 3"]) -> Embedding:
        """Find the containing (else the nearest) element of every point.

        Args:
            mesh: the mesh at rest.
            points: rest positions [m], shape [P, 3].

        Raises:
            InputError: `points` is not a finite [P, 3] array.
        """
        points = np.asarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(f"points: got shape {points.shape}; expected finite [P, 3] in metres")
        elements, barycentric, distance = _locate(mesh, points)
        return cls(
            elements=elements,
            weights=shape_values(barycentric, mesh.order),
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

    Systematic sampling: every element gets its share of the points up to one, so the spread over the body is
    more even than that of independent draws.

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


def _locate(mesh: TetMesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Element [P], barycentric coordinates [P, 4] and distance outside [P] of every point."""
    corners = mesh.vertices[mesh.corner_tets]
    tree = cKDTree(corners.mean(axis=1))
    inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
    parts = [
        _locate_chunk(tree, corners, inverse, points[start : start + CHUNK]) for start in range(0, len(points), CHUNK)
    ]
    if not parts:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 4)), np.zeros(0)
    elements, barycentric, distance = (np.concatenate(column) for column in zip(*parts, strict=True))
    return elements, barycentric, distance


def _locate_chunk(
    tree: cKDTree, corners: np.ndarray, inverse: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `_locate`: the deepest of the candidate elements; all elements are tried for points found in none."""
    candidates = tree.query(points, k=min(CANDIDATES, len(corners)))[1].reshape(len(points), -1)
    b = _barycentric(corners, inverse, candidates, points[:, None])
    best = b.min(axis=2).argmax(axis=1)
    rows = np.arange(len(points))
    elements, barycentric = candidates[rows, best], b[rows, best]
    distance = np.zeros(len(points))
    for p in np.flatnonzero(barycentric.min(axis=1) < -1e-9):
        every = _barycentric(corners, inverse, np.arange(len(corners)), points[p])
        inside = every.min(axis=1)
        if inside.max() >= -1e-9:
            elements[p] = inside.argmax()
        else:
            gaps = _distances(corners, points[p])
            elements[p], distance[p] = gaps.argmin(), gaps.min()
        barycentric[p] = every[elements[p]]
    return elements, barycentric, distance
