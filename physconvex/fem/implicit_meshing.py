"""Coarse tetrahedral meshes of a signed distance function within a budget of nodes."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError, InputError
from physconvex.fem.embedding import Embedding
from physconvex.fem.mesh import TetMesh, compact, to_quadratic
from physconvex.fem.mesh_volume import with_volume
from physconvex.fem.stuffing import SignedDistance, stuff

__all__ = ["tetrahedralize_implicit"]

# The reference that coarse meshes are judged by has this many lattice cells along the longest edge.
REFERENCE_CELLS = 24
# Lattice positions tried [cells], and how far the body is inflated so that thin parts catch a lattice vertex [cells].
OFFSETS = ((0.0, 0.0, 0.0), (0.25, 0.25, 0.0), (0.5, 0.0, 0.0), (0.0, 0.25, 0.25), (0.0, 0.5, 0.0), (0.25, 0.0, 0.25))
INFLATIONS = (0.0, 0.15)
# Trials of the cell size per lattice position, and the share of the node budget that is good enough.
TRIALS, FULL = 6, 0.85
# Nodes per lattice cell of a quadratic mesh: 2 vertices and 14 edges; more at the surface.
NODES_PER_CELL = {1: 4.0, 2: 26.0}


def tetrahedralize_implicit(
    signed_distance: SignedDistance,
    bounds: Float[np.ndarray, "2 3"],
    *,
    max_nodes: int = 700,
    order: Literal[1, 2] = 2,
    max_deviation: float = 0.08,
) -> TetMesh:
    """Regular coarse mesh of the inside of a signed distance function (isosurface stuffing), with its volume.

    Several positions and sizes of the lattice are tried; the mesh that leaves the least of the surface uncovered
    wins. The result depends on nothing but the arguments.

    Args:
        signed_distance: continuous, negative inside [m].
        bounds: lowest and highest corner of a box around the body [m].
        max_nodes: upper bound on the nodes of the result.
        order: 1 for linear, 2 for quadratic elements.
        max_deviation: largest accepted distance of the surface from the mesh, as a share of the largest edge of
            `bounds`; a lost limb shows in it.

    Raises:
        InputError: nothing lies inside, or the arguments are wrong.
        ConvergenceError: no mesh within `max_nodes` is one piece and follows the surface to `max_deviation`.
    """
    bounds = np.asarray(bounds, dtype=np.float64)
    if bounds.shape != (2, 3) or not np.isfinite(bounds).all() or (bounds[1] <= bounds[0]).any():
        raise InputError(f"bounds: got {bounds.tolist()}; expected the lowest and highest corner [2, 3] in metres")
    if max_nodes < 30:
        raise InputError(f"max_nodes: got {max_nodes}; expected at least 30")
    size = float((bounds[1] - bounds[0]).max())
    reference = stuff(signed_distance, bounds, size / REFERENCE_CELLS)
    surface = reference.vertices[np.unique(reference.boundary_faces)]
    best, least = None, np.inf
    for inflation in INFLATIONS:
        for offset in OFFSETS:
            mesh = _fitted(signed_distance, bounds, reference.volume, max_nodes, order, inflation, offset)
            if mesh is None:
                continue
            mesh = with_volume(mesh, reference.volume)
            deviation = Embedding.of_points(mesh, surface).max_distance / size
            if deviation < least:
                best, least = mesh, deviation
        if least < 0.5 * max_deviation:
            break
    if best is None or least > max_deviation:
        raise ConvergenceError(
            f"tetrahedralize_implicit: the best mesh of at most {max_nodes} nodes leaves the surface by {least:.3f} of "
            f"the size (max_deviation {max_deviation}); allow more nodes, or thicken the thin parts"
        )
    return best


def _fitted(
    signed_distance: SignedDistance,
    bounds: np.ndarray,
    volume: float,
    max_nodes: int,
    order: Literal[1, 2],
    inflation: float,
    offset: tuple[float, float, float],
) -> TetMesh | None:
    """The mesh in one piece with the most nodes within the budget, for one lattice position; None if there is none."""
    cell, best = float(np.cbrt(NODES_PER_CELL[order] * volume / max_nodes)), None
    for _ in range(TRIALS):
        mesh = _in_order(signed_distance, bounds, cell, inflation, offset, order)
        count = 0 if mesh is None else len(mesh.vertices)
        if mesh is not None and count <= max_nodes and (best is None or count > len(best.vertices)):
            best = mesh
            if count >= FULL * max_nodes:
                break
        cell *= float(np.clip((max(count, 1) / (0.93 * max_nodes)) ** (1 / 2.4), 0.8, 1.3))
    return best


def _in_order(
    signed_distance: SignedDistance,
    bounds: np.ndarray,
    cell: float,
    inflation: float,
    offset: tuple[float, float, float],
    order: Literal[1, 2],
) -> TetMesh | None:
    """Largest piece of the stuffed lattice; None where nothing is inside or a sizeable second piece exists."""
    try:
        mesh = stuff(signed_distance, bounds, cell, level=inflation * cell, offset=offset)
    except InputError:  # the lattice is too coarse for this body: the caller takes a smaller cell
        return None
    mesh = largest_piece(mesh)
    if mesh is None:
        return None
    return to_quadratic(mesh) if order == 2 else mesh


def largest_piece(mesh: TetMesh, *, share: float = 0.98) -> TetMesh | None:
    """The elements connected through faces that make up at least `share` of the volume; None if there are no such."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    faces = np.sort(mesh.corner_tets[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]], axis=2).reshape(-1, 3)
    _, face = np.unique(faces, axis=0, return_inverse=True)
    count, elements = len(mesh.tets), np.repeat(np.arange(len(mesh.tets)), 4)
    links = coo_matrix((np.ones(len(elements)), (elements, count + face.reshape(-1))))
    total = max(links.shape)
    links.resize(total, total)
    pieces = connected_components(links, directed=False)[1][:count]
    volumes = np.bincount(pieces, mesh.element_volumes)
    if volumes.max() < share * volumes.sum():
        return None
    return compact(mesh.vertices, mesh.tets[pieces == volumes.argmax()])
