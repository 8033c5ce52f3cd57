"""A regular mesh for a box-shaped body, such as a test beam or cube.

A general mesh of few, irregular tetrahedra bends to one side, and its surface deviates from the box. For a held beam
the numerical error is then as large as many effects, and a cube that falls flat tumbles after its first impact. Cells
aligned with the box avoid both.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from jaxtyping import Float

from physconvex.gap.thresholds import BODY_MESH
from physconvex.io import Boundary, Capture
from physconvex.mesh import TetMesh, box_mesh


def box_of_body(capture: Capture, max_nodes: int) -> TetMesh | None:
    """Quadratic mesh of an axis-aligned box; None for other bodies, and if the body's own mesh has few tets."""
    tets, surface = capture.tets(), capture.mesh()
    if tets is not None:
        vertices, volume = tets.vertices, float(tets.element_volumes.sum())
        outside = vertices[np.unique(tets.boundary_faces)]
        if len(tets.vertices) <= max_nodes // 4:  # about as many as quadratic ones have corners
            return None
    elif surface is not None:
        outside, volume = np.asarray(surface.vertices, dtype=np.float64), float(surface.volume)
    else:
        return None
    low, high = outside.min(0), outside.max(0)
    edges = high - low
    away = np.minimum(outside - low, high - outside).min(1)  # distance to the nearest face
    if abs(volume / edges.prod() - 1) > BODY_MESH.box or away.max() > BODY_MESH.box * edges.max():
        return None
    held = _held_end(capture.boundary(), low, high)
    cells = box_cells(edges, max_nodes, across=1 if held is None else 2)
    if held is None:
        mesh = box_mesh((float(edges[0]), float(edges[1]), float(edges[2])), cells, mirrored=True)
        return TetMesh(mesh.vertices + low, mesh.tets)
    return with_plane(low, high, cells, *held, mirrored=True)


def _held_end(
    boundary: Boundary | None, low: Float[np.ndarray, " 3"], high: Float[np.ndarray, " 3"]
) -> tuple[int, float] | None:
    """Axis and place [m] of the plane where the box that holds one end of the body ends; None without one."""
    if boundary is None or boundary.clamped_box is None:
        return None
    first, last = boundary.clamped_box
    ends = [
        (axis, float(plane))
        for axis in range(3)
        for plane, covers in ((last[axis], first[axis] <= low[axis]), (first[axis], last[axis] >= high[axis]))
        if covers and BODY_MESH.plane < (plane - low[axis]) / (high[axis] - low[axis]) < 1 - BODY_MESH.plane
    ]
    return ends[0] if len(ends) == 1 else None


def with_plane(
    low: Float[np.ndarray, " 3"], high: Float[np.ndarray, " 3"], cells: tuple[int, int, int], axis: int, plane: float,
    *, order: int = 2, mirrored: bool = False,
) -> TetMesh:  # fmt: skip
    """Mesh of a box with nodes in a plane across one axis.

    The plane is the end of the held part of a beam. If the nodes lie off the plane, the length of the beam is wrong by
    half a cell, and its stiffness by several times as much.

    Args:
        low, high: corners [m].
        cells: approximate number along each edge; each side of the plane has at least one.
        axis, plane: axis across the plane, and coordinate of the plane [m].
        order, mirrored: see `physconvex.mesh.box_mesh`.
    """
    share = (plane - low[axis]) / (high[axis] - low[axis])
    first = max(round(share * cells[axis]), 1)
    rest = max(round((1 - share) * cells[axis]), 1)
    numbers = list(cells)
    numbers[axis] = first + rest
    mesh = box_mesh((1.0, 1.0, 1.0), (numbers[0], numbers[1], numbers[2]), order=order, mirrored=mirrored)
    knots = np.array([0.0, first / (first + rest), 1.0])
    unit = mesh.vertices.copy()
    unit[:, axis] = np.interp(unit[:, axis], knots, np.array([0.0, share, 1.0]))
    return TetMesh(low + unit * (high - low), mesh.tets)


def box_cells(edges: Float[np.ndarray, " 3"], max_nodes: int, *, across: int = 1) -> tuple[int, int, int]:
    """Cells along each edge [m]: as even as the number of nodes allows; a slender box is divided along its length.

    Args:
        edges: edges of the box.
        max_nodes: limit of a quadratic mesh.
        across: cells across a slender box; more than one allows a third more nodes. With one cell, a bar whose
            stiffness varies over its section bends sideways nearly as far as down.
    """
    longest, others = int(edges.argmax()), np.sort(edges)[:2]
    if edges.max() >= BODY_MESH.slender * others[1]:
        section = (2 * across + 1) ** 2
        allowed = max_nodes if across == 1 else BODY_MESH.several_across * max_nodes
        most = min((allowed / section - 1) // 2, BODY_MESH.most_cells)
        along = int(np.clip(round(edges.max() / (BODY_MESH.slender_cell * others[1])), 1, most))
        cells = [across] * 3
        cells[longest] = along
        return cells[0], cells[1], cells[2]
    possible = [
        c for c in product(range(1, BODY_MESH.most_cells + 1), repeat=3) if np.prod([2 * n + 1 for n in c]) <= max_nodes
    ]
    best = min(possible, key=lambda c: (float((edges / c).max()), float(np.prod(c))))
    return best[0], best[1], best[2]
