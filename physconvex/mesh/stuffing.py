"""Isosurface stuffing (Labelle and Shewchuk 2007): tetrahedra inside a signed distance function.

A body-centred cubic lattice covers the body. Lattice vertices close to the surface are moved onto it. Fixed patterns
trim the elements that the surface still cuts. The method is fast and exactly reproducible on one machine; its elements
have one size and bounded angles. Parts thinner than about one lattice cell are lost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from physconvex.errors import InputError
from physconvex.mesh.tet_mesh import TetMesh, compact, mesh_edges, oriented

# Distance from points [N, 3] to a surface, negative inside; shape [N], metres.
SignedDistance = Callable[[Float[np.ndarray, "N 3"]], Float[np.ndarray, " N"]]

# Cut points closer to a lattice vertex than this share of the edge pull the vertex onto the surface: long and
# short edges (table 1 of the paper, the row that bounds the angles to [10.7, 164.8] degrees).
ALPHA_LONG, ALPHA_SHORT = 0.24999, 0.41189
ROOT_ITERATIONS = 8


def stuff(
    signed_distance: SignedDistance,
    bounds: Float[np.ndarray, "2 3"],
    cell: float,
    *,
    level: float = 0.0,
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> TetMesh:
    """Linear tetrahedra that fill the region with `signed_distance` < `level`.

    Args:
        signed_distance: continuous, negative inside; only its sign and zeros matter [m].
        bounds: lowest and highest corner of a box around the body [m].
        cell: edge of the cubic lattice cell [m].
        level: value of `signed_distance` at the surface of the mesh [m].
        offset: shift of the lattice from the centre of `bounds`, in cells.

    Raises:
        InputError: `cell` is not positive, or no lattice vertex is inside (the body is thinner than the cell).
    """
    bounds = np.asarray(bounds, dtype=np.float64)
    if not 0 < cell < np.inf:
        raise InputError(f"cell: got {cell}; expected a positive length in metres")
    vertices, tets = _lattice(bounds + cell * np.asarray(offset), cell)
    values = np.asarray(signed_distance(vertices), dtype=np.float64) - level
    tets = tets[(values[tets] < 0).any(axis=1)]
    edges = mesh_edges(tets)[0]
    edges = edges[values[edges[:, 0]] * values[edges[:, 1]] < 0]
    fraction = _roots(signed_distance, level, vertices, values, edges)
    long = np.isclose(np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1), cell)
    points = vertices[edges[:, 0]] + fraction[:, None] * (vertices[edges[:, 1]] - vertices[edges[:, 0]])
    cuts = _Cuts(edges, fraction, points, long)
    return _trim(vertices, values, tets, cuts.select(_warp(vertices, values, cuts)))


@dataclass(frozen=True)
class _Cuts:
    """Intersections of lattice edges with the surface.

    Attributes:
        edges: their vertices, the lower number first, shape [C, 2].
        fraction: way along each, in (0, 1).
        points: [m], shape [C, 3].
        long: whether the edge is a long one.
    """

    edges: Int[np.ndarray, "C 2"]
    fraction: Float[np.ndarray, " C"]
    points: Float[np.ndarray, "C 3"]
    long: Bool[np.ndarray, " C"]

    def select(self, which: Bool[np.ndarray, " C"]) -> _Cuts:
        """Some of them."""
        return _Cuts(self.edges[which], self.fraction[which], self.points[which], self.long[which])


def _lattice(bounds: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and tetrahedra of a body-centred cubic lattice wider than `bounds`, centred on it."""
    counts = np.ceil((bounds[1] - bounds[0]) / cell).astype(int) + 4
    origin = bounds.mean(axis=0) - 0.5 * counts * cell
    corner = np.stack(np.meshgrid(*(np.arange(n + 1.0) for n in counts), indexing="ij"), axis=-1)
    centre = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in counts), indexing="ij"), axis=-1)
    corner_index = np.arange(corner[..., 0].size).reshape(corner.shape[:3])
    centre_index = corner_index.size + np.arange(centre[..., 0].size).reshape(centre.shape[:3])
    tets = []
    for axis in range(3):
        # Axis first: edges from corner (i, j, k) to (i + 1, j, k), ringed by four centres.
        lattice = np.moveaxis(corner_index, axis, 0)
        middle = np.moveaxis(centre_index, axis, 0)
        start, end = lattice[:-1, 1:-1, 1:-1].ravel(), lattice[1:, 1:-1, 1:-1].ravel()
        ring = [middle[:, :-1, :-1], middle[:, 1:, :-1], middle[:, 1:, 1:], middle[:, :-1, 1:]]
        for i in range(4):
            tets.append(np.stack([start, end, ring[i].ravel(), ring[(i + 1) % 4].ravel()], axis=1))
    vertices = np.concatenate([corner.reshape(-1, 3), centre.reshape(-1, 3)]) * cell + origin
    return vertices, np.concatenate(tets)


def _roots(
    signed_distance: SignedDistance, level: float, vertices: np.ndarray, values: np.ndarray, edges: np.ndarray
) -> np.ndarray:
    """Position of the surface along each edge, in (0, 1): regula falsi with the Illinois rule."""
    start, along = vertices[edges[:, 0]], vertices[edges[:, 1]] - vertices[edges[:, 0]]
    low, high = np.zeros(len(edges)), np.ones(len(edges))
    value_low, value_high = values[edges[:, 0]].copy(), values[edges[:, 1]].copy()
    for _ in range(ROOT_ITERATIONS):
        middle = (low * value_high - high * value_low) / (value_high - value_low)
        value = np.asarray(signed_distance(start + middle[:, None] * along)) - level
        same = value * value_low > 0
        value_high = np.where(same, np.where(value == 0, value_high, 0.5 * value_high), value)
        value_low = np.where(same, value, 0.5 * value_low)
        low, high = np.where(same, middle, low), np.where(same, high, middle)
        exact = value_high == value_low  # both zero: the root is exact
        value_low = np.where(exact, -1.0, value_low)
        value_high = np.where(exact, 1.0, value_high)
    return np.clip(middle, 1e-9, 1 - 1e-9)


def _warp(vertices: np.ndarray, values: np.ndarray, cuts: _Cuts) -> Bool[np.ndarray, " C"]:
    """Move lattice vertices onto near cut points (in place, their value becomes zero); returns the remaining cuts.

    The nearest pairs go first; moving a vertex removes every cut on its edges (section 3 of the paper).
    """
    edges, fraction = cuts.edges, cuts.fraction
    alpha = np.where(cuts.long, ALPHA_LONG, ALPHA_SHORT)
    share = np.concatenate([fraction, 1 - fraction]) / np.concatenate([alpha, alpha])
    vertex = edges.T.ravel()
    order = np.argsort(share, kind="stable")
    order = order[share[order] < 1]
    by_vertex = np.argsort(vertex, kind="stable")
    starts = np.searchsorted(vertex[by_vertex], np.arange(len(vertices) + 1))
    alive = np.ones(len(edges), dtype=bool)
    for item in order:
        cut, node = item % len(edges), vertex[item]
        if alive[cut]:
            vertices[node], values[node] = cuts.points[cut], 0.0
            alive[by_vertex[starts[node] : starts[node + 1]] % len(edges)] = False
    return alive


def _trim(vertices: np.ndarray, values: np.ndarray, tets: np.ndarray, cuts: _Cuts) -> TetMesh:
    """The part of each lattice tetrahedron inside the surface, cut into tetrahedra (figure 3 of the paper)."""
    count, many = len(vertices), len(cuts.points)
    keys = cuts.edges[:, 0] * count + cuts.edges[:, 1]
    # Cuts on long edges come first in the numbering that decides diagonals, then those on short edges.
    rank = np.concatenate([np.arange(count) + many * 2, np.where(cuts.long, 0, many) + np.arange(many)])
    state = np.sign(values[tets])
    order = np.argsort(state, axis=1, kind="stable")
    tets, state = np.take_along_axis(tets, order, axis=1), np.take_along_axis(state, order, axis=1)
    inside, outside = (state < 0).sum(axis=1), (state > 0).sum(axis=1)

    def cut(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        low, high = np.minimum(a, b), np.maximum(a, b)
        return count + np.searchsorted(keys, low * count + high)

    parts = [tets[(inside > 0) & (outside == 0)]]
    for n in (1, 2, 3):
        a, b, c, d = tets[(inside == 1) & (outside == n)].T
        parts.append(np.stack([a, cut(a, b) if n > 2 else b, cut(a, c) if n > 1 else c, cut(a, d)], axis=1))
    a, b, c, d = tets[(inside == 2) & (outside == 1)].T
    parts += _pyramid(c, [a, b, cut(b, d), cut(a, d)], rank)
    a, b, c, d = tets[(inside == 2) & (outside == 2)].T
    parts += _prism([a, cut(a, c), cut(a, d)], [b, cut(b, c), cut(b, d)], rank)
    a, b, c, d = tets[(inside == 3) & (outside == 1)].T
    parts += _prism([a, b, c], [cut(a, d), cut(b, d), cut(c, d)], rank)
    result, everything = np.concatenate(parts), np.concatenate([vertices, cuts.points])
    if len(result) == 0:
        raise InputError("cell: the body is thinner than the lattice everywhere; take a smaller cell")
    return compact(everything, oriented(everything, result))


def _pyramid(apex: np.ndarray, base: list[np.ndarray], rank: Int[np.ndarray, " N"]) -> list[Int[np.ndarray, "E 4"]]:
    """Pyramids as two tetrahedra each; the diagonal of the base leaves from its corner of lowest rank."""
    q = np.stack(base, axis=1)
    first = rank[q].argmin(axis=1) if len(q) else np.zeros(0, dtype=np.int64)
    q = np.take_along_axis(q, (first[:, None] + np.arange(4)) % 4, axis=1)
    return [np.column_stack([apex, q[:, 0], q[:, k], q[:, k + 1]]) for k in (1, 2)]


def _prism(
    bottom: list[np.ndarray], top: list[np.ndarray], rank: Int[np.ndarray, " N"]
) -> list[Int[np.ndarray, "E 4"]]:
    """Prisms as three tetrahedra each; every diagonal leaves from the lowest rank (Dompierre et al. 1999)."""
    a, b = np.stack(bottom, axis=1), np.stack(top, axis=1)
    both = rank[np.concatenate([a, b], axis=1)]
    first = both.argmin(axis=1) if len(both) else np.zeros(0, dtype=np.int64)
    swap = (first >= 3)[:, None]
    a, b = np.where(swap, b, a), np.where(swap, a, b)
    turn = (first[:, None] + np.arange(3)) % 3
    a, b = np.take_along_axis(a, turn, axis=1), np.take_along_axis(b, turn, axis=1)
    rest = [a[:, 1], a[:, 2], b[:, 2], b[:, 1]]
    return [np.column_stack([a[:, 0], b]), *_pyramid(a[:, 0], rest, rank)]
