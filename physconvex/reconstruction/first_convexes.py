"""First convexes: prisms under a surface, boxes inside it, octahedra about points; conversion to other point counts."""

from __future__ import annotations

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from physconvex.reconstruction.triangles import Triangles

GREATEST_GROWTH = 2.0  # of a sliver whose edges are moved outward
SHARE_OF_WALL = 0.4  # of the distance to the other side of the body: greatest depth of a prism
SURFACE_SAMPLES = 40_000
UNPAINTED = 1e-3  # opacity of convexes that fill the inside: not drawn, since convexes are sorted by their centres
BULGE = 0.1  # distance outside of a point that is added to an edge, over its distance from the middle
INNER_EDGES = np.array([[3, 4], [4, 5], [5, 3]])  # of a prism
LATTICE = 64  # cells along the longest edge at most
BOX_POINTS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
WEDGES = np.array([[0, 1, 2, 3, 4, 5], [2, 3, 4, 5, 6, 7]])  # of a box, sharing the diagonal plane


def prisms(triangles: Triangles, mesh: trimesh.Trimesh, *, depth: float, overhang: float) -> Float[np.ndarray, "F 6 3"]:
    """A prism of six points under every triangle.

    Args:
        mesh: the closed surface of the triangles; prisms end before its other side.
        depth: of the prisms [m].
        overhang: distance by which their edges are moved outward [m], so that soft edges of neighbours overlap.
    """
    corners = triangles.corners
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1), axis=2)  # opposite the corner
    perimeter = lengths.sum(axis=1, keepdims=True)
    middle = (lengths[..., None] * corners).sum(axis=1, keepdims=True) / perimeter[..., None]  # of the inscribed circle
    radius = 2 * triangles.areas / perimeter[:, 0]
    growth = np.minimum(1 + overhang / np.maximum(radius, 1e-12), GREATEST_GROWTH)
    outer = middle + growth[:, None, None] * (corners - middle)
    wall = _wall(mesh, corners, triangles.normals)
    inward = np.minimum(depth, SHARE_OF_WALL * wall)[..., None] * triangles.normals
    return np.concatenate([outer, outer - inward], axis=1)


def _wall(mesh: trimesh.Trimesh, corners: np.ndarray, normals: np.ndarray) -> Float[np.ndarray, "F 3"]:
    """Distance [m] from the corners inward to the other side; infinite if there is none.

    Rays start a little towards the middle of the triangle, so that they do not hit edges between faces.
    """
    size = float(np.ptp(mesh.vertices, axis=0).max())
    inner = 0.9 * corners + 0.1 * corners.mean(axis=1, keepdims=True)
    origins = (inner - 1e-4 * size * normals).reshape(-1, 3)
    directions = -normals.reshape(-1, 3)
    where, rays, _ = mesh.ray.intersects_location(origins, directions, multiple_hits=False)
    wall = np.full(len(origins), np.inf)
    wall[rays] = np.linalg.norm(where - origins[rays], axis=1)
    return wall.reshape(corners.shape[:2])


def fillers(mesh: trimesh.Trimesh, *, depth: float, most: int) -> Float[np.ndarray, "B 6 3"]:
    """At most `most` wedges that fill the space inside a closed surface below prisms of a `depth` [m].

    Lattice cells that are completely inside are joined to boxes, each cut into two wedges of six points. The lattice is
    coarsened until they are few enough. Boxes overlap by a twentieth of a cell.
    """
    low, size = mesh.bounds[0], float(np.ptp(mesh.bounds, axis=0).max())
    samples, _ = trimesh.sample.sample_surface(mesh, SURFACE_SAMPLES, seed=0)
    tree = cKDTree(samples)
    cells = min(LATTICE, max(4, int(np.ceil(np.sqrt(3) * size / max(depth, size / LATTICE)))))  # no gaps to the prisms
    while cells >= 4 and most >= 2:
        edge = size / cells
        boxes = _joined(_cells_inside(mesh, tree, edge))
        if 2 * len(boxes) <= most:
            return wedges(boxes, low, edge, overlap=0.05)
        cells = int(0.85 * cells)
    return np.zeros((0, 6, 3))


def wedges(
    boxes: Int[np.ndarray, "B 2 3"], low: Float[np.ndarray, " 3"], edge: float, *, overlap: float = 0.0
) -> Float[np.ndarray, "W 6 3"]:
    """Two wedges of six points [m] for each box of lattice cells; boxes are widened by an overlap, in cells."""
    spans = (boxes[:, 1] - boxes[:, 0] + 2 * overlap)[:, None] * BOX_POINTS + boxes[:, :1] - overlap
    return (low + edge * spans)[:, WEDGES].reshape(-1, 6, 3)


def lattice_cells(mesh: trimesh.Trimesh, edge: float) -> tuple[Int[np.ndarray, " 3"], Float[np.ndarray, "C 3"]]:
    """Number of cells along each axis of a lattice about a mesh, and their middles [m]."""
    shape = np.ceil(np.ptp(mesh.bounds, axis=0) / edge).astype(int)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    return shape, (mesh.bounds[0] + edge * (grid + 0.5)).reshape(-1, 3)


def _cells_inside(mesh: trimesh.Trimesh, tree: cKDTree, edge: float) -> Bool[np.ndarray, "X Y Z"]:
    """Cells that are inside as a whole."""
    shape, centres = lattice_cells(mesh, edge)
    half_diagonal = 0.5 * np.sqrt(3) * edge
    deep = np.flatnonzero(tree.query(centres)[0] > half_diagonal)
    inside = np.zeros(len(centres), dtype=bool)
    if len(deep):
        inside[deep] = mesh.contains(centres[deep])
    return inside.reshape(shape)


def _joined(inside: Bool[np.ndarray, "X Y Z"]) -> Int[np.ndarray, "B 2 3"]:
    """Boxes (first cell, cell after the last) that fill the cells: each is grown along x, then y, then z."""
    left = inside.copy()
    boxes = []
    for first in np.argwhere(inside):
        if not left[tuple(first)]:
            continue
        last = first + 1
        for axis in range(3):
            while last[axis] < left.shape[axis]:
                layer = [slice(a, b) for a, b in zip(first, last, strict=True)]
                layer[axis] = slice(last[axis], last[axis] + 1)
                if not left[tuple(layer)].all():
                    break
                last[axis] += 1
        left[tuple(slice(a, b) for a, b in zip(first, last, strict=True))] = False
        boxes.append((first, last))
    return np.array(boxes, dtype=np.int64).reshape(-1, 2, 3)


def octahedra(points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 6 3"]:
    """An octahedron about each point, of the size of the mean distance to the three nearest others."""
    distance = cKDTree(points).query(points, k=[*range(2, 2 + min(3, len(points) - 1))])[0]
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    return points[:, None] + distance.mean(axis=1)[:, None, None] * axes


def with_count(hulls: Float[np.ndarray, "N 6 3"], count: int) -> Float[np.ndarray, "N K 3"]:
    """Hulls of that many points (3 to 9) from prisms of six: outer triangle first, then the inner one.

    With three, the outer triangle is left. With four and five, inner corners are merged to their means. With more,
    middles of inner edges are added, a little outside, so that they are corners too.
    """
    outer, inner = hulls[:, :3], hulls[:, 3:]
    if count == 3:
        return outer
    if count == 4:
        return np.concatenate([outer, inner.mean(axis=1, keepdims=True)], axis=1)
    if count == 5:
        return np.concatenate([outer, inner[:, :1], inner[:, 1:].mean(axis=1, keepdims=True)], axis=1)
    middle = hulls.mean(axis=1, keepdims=True)
    added = middle + (1 + BULGE) * (hulls[:, INNER_EDGES[: count - 6]].mean(axis=2) - middle)
    return np.concatenate([hulls, added], axis=1)
