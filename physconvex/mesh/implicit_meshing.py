"""Coarse, regular tetrahedral meshes within a budget of nodes: stuffed lattices fitted to the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import map_coordinates

from physconvex.errors import ConvergenceError, InputError
from physconvex.mesh.embedding import Embedding
from physconvex.mesh.stuffing import SignedDistance, stuff
from physconvex.mesh.surface_fitting import fit_to_surface, with_volume
from physconvex.mesh.surfaces import enclosed_volume
from physconvex.mesh.tet_mesh import FACE_CORNERS, TetMesh, compact, mean_ratios, node_count, to_quadratic

# Cells along the longest edge of the grid that replaces the distance function, and of the lattice for a missing
# surface.
GRID_CELLS, REFERENCE_CELLS = 40, 20
# Inflation of the body so that thin parts catch a lattice vertex, and offset of the lattice [cells].
LATTICES = (
    (0.15, (0.0, 0.0, 0.0)),
    (0.30, (0.5, 0.0, 0.0)),
    (0.15, (0.25, 0.25, 0.25)),
    (0.30, (0.0, 0.0, 0.0)),
    (0.30, (0.25, 0.25, 0.25)),
    (0.0, (0.0, 0.0, 0.0)),
)
# Trials of the cell size per lattice, and sufficient share of the node budget.
TRIALS, FULL = 5, 0.85
# First guess of the nodes per lattice cell of the body's volume, surface included.
NODES_PER_CELL = {1: 5.0, 2: 30.0}
SURFACE_SAMPLES = 700
PLASTIC = 1.32471795724474602596  # root of x³ = x + 1
# Meshes with flatter elements get a larger deviation.
GOOD_MEAN_RATIO = 0.25


@dataclass(frozen=True)
class _Target:
    """The target of a mesh, and its largest size.

    Attributes:
        field: signed distance.
        bounds: of the body.
        points, normals: samples of its surface.
        volume: [m³].
        euler: Euler characteristic of the surface.
        max_nodes, order: of the mesh.
    """

    field: SignedDistance
    bounds: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    volume: float
    euler: int
    max_nodes: int
    order: Literal[1, 2]


def tetrahedralize_implicit(
    signed_distance: SignedDistance,
    bounds: Float[np.ndarray, "2 3"],
    *,
    surface: tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]] | None = None,
    max_nodes: int = 700,
    order: Literal[1, 2] = 2,
    max_deviation: float = 0.1,
) -> TetMesh:
    """Regular coarse mesh of the inside of a signed distance function, of the same volume and topology.

    Isosurface stuffing gives the connectivity. The nodes are then moved so that the boundary follows the surface
    (`fit_to_surface`) and encloses its volume. Lattices are tried until one is accurate enough. The result is
    deterministic.

    Args:
        signed_distance: continuous, negative inside, roughly a distance near the surface [m].
        bounds: lowest and highest corner of a box around the body [m].
        surface: the closed surface, vertices [m] and outward faces, if it is at hand (saves time).
        max_nodes: upper bound on the nodes of the result.
        order: 1 for linear, 2 for quadratic elements.
        max_deviation: largest accepted distance between the surface and the mesh, as a share of the largest edge of
            `bounds`; it detects lost limbs.

    Raises:
        InputError: nothing is inside, or the arguments are wrong.
        ConvergenceError: no mesh within `max_nodes` is in one piece and follows the surface to `max_deviation`.
    """
    bounds = np.asarray(bounds, dtype=np.float64)
    if bounds.shape != (2, 3) or not np.isfinite(bounds).all() or (bounds[1] <= bounds[0]).any():
        raise InputError(f"bounds: got {bounds.tolist()}; expected the lowest and highest corner [2, 3] in metres")
    if max_nodes < 30:
        raise InputError(f"max_nodes: got {max_nodes}; expected at least 30")
    size = float((bounds[1] - bounds[0]).max())
    field = _gridded(signed_distance, bounds, size / GRID_CELLS)
    vertices, faces = _fine_surface(field, bounds, size / REFERENCE_CELLS) if surface is None else surface
    volume = enclosed_volume(vertices, faces)
    if volume is None:
        raise InputError("surface: not closed and outward oriented; close it, or use fTetWild")
    _, index = np.unique(vertices, axis=0, return_inverse=True)
    euler = euler_characteristic(index.reshape(-1)[faces])
    target = _Target(field, bounds, *_sampled(vertices, faces), volume, euler, max_nodes, order)
    best, least = _best_mesh(target, 0.6 * max_deviation * size, same_topology=True)
    if least > max_deviation * size:  # small holes may close if the surface stays near
        best, least = _best_mesh(target, max_deviation * size, same_topology=False)
    least /= size
    if best is None or least > max_deviation:
        raise ConvergenceError(
            f"tetrahedralize_implicit: the best mesh of at most {max_nodes} nodes leaves the surface by {least:.3f} of "
            f"the size (max_deviation {max_deviation}); allow more nodes, or thicken the thin parts"
        )
    return to_quadratic(best) if order == 2 else best


def _best_mesh(target: _Target, good_enough: float, *, same_topology: bool) -> tuple[TetMesh | None, float]:
    """The first fitted mesh with a small enough deviation [m], else the best, and its deviation."""
    best, least = None, np.inf
    for inflation, offset in LATTICES:
        mesh = _stuffed(target, inflation, offset, same_topology=same_topology)
        if mesh is None:
            continue
        mesh = with_volume(fit_to_surface(mesh, target.points, target.normals), target.volume)
        quality = float(mean_ratios(mesh.vertices, mesh.tets).min())
        deviation = _deviation(mesh, target) * max(1.0, GOOD_MEAN_RATIO / quality)
        if deviation < least:
            best, least = mesh, deviation
        if least <= good_enough:
            break
    return best, least


def _gridded(signed_distance: SignedDistance, bounds: np.ndarray, spacing: float) -> SignedDistance:
    """`signed_distance` by linear interpolation on a grid, which is much cheaper for many evaluations."""
    counts = np.ceil((bounds[1] - bounds[0]) / spacing).astype(int) + 9
    origin = bounds.mean(axis=0) - 0.5 * (counts - 1) * spacing
    axes = [origin[a] + spacing * np.arange(counts[a]) for a in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    values = np.asarray(signed_distance(points), dtype=np.float64).reshape(counts)
    if not (values < 0).any():
        raise InputError("signed_distance: nowhere negative on the grid; expected a body inside `bounds`")
    return lambda p: map_coordinates(values, ((p - origin) / spacing).T, order=1, mode="nearest")


def _fine_surface(field: SignedDistance, bounds: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Surface of a stuffed lattice."""
    fine = largest_piece(stuff(field, bounds, cell), share=0.0)
    assert fine is not None
    return fine.vertices, fine.boundary_faces


def _sampled(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points spread evenly over the area of a surface, and the normals of their triangles.

    The centre of a triangle with one point; a plastic sequence (Roberts 2018), folded into a triangle with more.
    """
    x = vertices[faces]
    cross = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    area = np.linalg.norm(cross, axis=1)
    cumulative = np.cumsum(area)
    levels = (np.arange(SURFACE_SAMPLES) + 0.5) / SURFACE_SAMPLES * cumulative[-1]
    triangle = np.searchsorted(cumulative, levels)
    _, first, shared = np.unique(triangle, return_index=True, return_counts=True)
    number = np.arange(SURFACE_SAMPLES) - np.repeat(first, shared)
    weights = (0.5 + (number[:, None] + 1) / PLASTIC ** np.array([1, 2])) % 1.0
    weights = np.where(weights.sum(axis=1, keepdims=True) > 1, 1 - weights, weights)
    weights[np.repeat(shared == 1, shared)] = 1 / 3
    corner = np.column_stack([1 - weights.sum(axis=1), weights])
    return np.einsum("sk,skd->sd", corner, x[triangle]), cross[triangle] / area[triangle, None]


def euler_characteristic(faces: Int[np.ndarray, "F 3"]) -> int:
    """Vertices minus edges plus faces of a closed triangle surface: 2 for a ball, 0 for a ring."""
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return len(np.unique(faces)) - len(edges) + len(faces)


def _stuffed(
    target: _Target, inflation: float, offset: tuple[float, float, float], *, same_topology: bool
) -> TetMesh | None:
    """Linear mesh in one piece, of the right topology if requested, with the most nodes within the budget, if any."""
    max_nodes, order = target.max_nodes, target.order
    cell, best, most = float(np.cbrt(NODES_PER_CELL[order] * target.volume / max_nodes)), None, 0
    for _ in range(TRIALS):
        try:
            pieces = stuff(target.field, target.bounds, cell, level=inflation * cell, offset=offset)
        except InputError:  # thinner than the lattice everywhere
            cell *= 0.8
            continue
        count, mesh = node_count(pieces.vertices, pieces.tets, order), largest_piece(pieces)
        if mesh is not None and most < count <= max_nodes:
            if not same_topology or euler_characteristic(mesh.boundary_faces) == target.euler:
                best, most = mesh, count
                if count >= FULL * max_nodes:
                    break
        # To 93 % of the budget if fewer nodes resolve the body, else to another size.
        cell *= float(np.clip((count / (0.93 * max_nodes)) ** (1 / 2.4), 0.8, 1.3)) * (0.97 if mesh is None else 1.0)
    return best


def _deviation(mesh: TetMesh, target: _Target) -> float:
    """Largest distance of the surface from the mesh, or of the mesh boundary out of the surface [m]."""
    faces = mesh.boundary_faces
    boundary = np.concatenate([mesh.vertices[np.unique(faces)], mesh.vertices[faces].mean(axis=1)])
    return max(Embedding.of_points(mesh, target.points).max_distance, float(target.field(boundary).max()))


def largest_piece(mesh: TetMesh, *, share: float = 0.98) -> TetMesh | None:
    """The elements connected through faces that make up at least `share` of the volume; None if there are none."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    faces = np.sort(mesh.corner_tets[:, FACE_CORNERS], axis=2).reshape(-1, 3)
    _, face = np.unique(faces, axis=0, return_inverse=True)
    count, elements = len(mesh.tets), np.repeat(np.arange(len(mesh.tets)), 4)
    total = count + int(face.max()) + 1
    links = coo_matrix((np.ones(len(elements)), (elements, count + face.reshape(-1))), shape=(total, total))
    pieces = connected_components(links, directed=False)[1][:count]
    volumes = np.bincount(pieces, mesh.element_volumes)
    if volumes.max() < share * volumes.sum():
        return None
    return compact(mesh.vertices, mesh.tets[pieces == volumes.argmax()])
