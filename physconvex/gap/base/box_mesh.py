"""A regular mesh for a body that is a box, as test beams and cubes are, in the place of one made for any shape.

A mesh of few and irregular tetrahedra bends to one side, and its surface is not quite that of the box: of a held beam
that leaves a numerical error as large as many an effect, and a cube that falls flat tumbles after its first impact.
Cells that follow the box have neither.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from jaxtyping import Float

from physconvex.gap.thresholds import BODY_MESH
from physconvex.io import Boundary, Capture
from physconvex.mesh import TetMesh, box_mesh


def box_of_body(capture: Capture, max_nodes: int) -> TetMesh | None:
    """Quadratic mesh of a body that is a box along the axes; None for others, and where its own tets are few."""
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
    away = np.minimum(outside - low, high - outside).min(1)  # from the nearest face
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
    """Axis and place [m] of the plane where a box that holds one end of the body ends; None without such."""
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
    """Mesh of a box of which nodes lie in a plane across one axis.

    What a box holds of a beam ends there: on nodes to either side of it, the beam is longer or shorter by half a cell,
    by which its stiffness is off by several times as much.

    Args:
        low, high: corners [m].
        cells: along each edge, about; each side of the plane has at least one.
        axis: across the plane.
        plane: its coordinate [m].
        order: of the elements.
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
    """Cells along each edge [m]: as even as so many nodes allow, of a slender box along its length alone.

    Args:
        edges: of the box.
        max_nodes: of a quadratic mesh.
        across: cells across a slender box; a third more nodes are allowed if they are more than one. On one cell, a bar
            whose stiffness varies over its section bends to the side nearly as far as down.
    """
    longest, others = int(edges.argmax()), np.sort(edges)[:2]
    if edges.max() >= BODY_MESH.slender * others[1]:
        section = (2 * across + 1) ** 2
        allowed = max_nodes if across == 1 else BODY_MESH.several_across * max_nodes
        along = int(
            np.clip(
                round(edges.max() / (BODY_MESH.slender_cell * others[1])),
                1,
                min((allowed / section - 1) // 2, BODY_MESH.most_cells),
            )
        )
        cells = [across] * 3
        cells[longest] = along
        return cells[0], cells[1], cells[2]
    possible = [
        c for c in product(range(1, BODY_MESH.most_cells + 1), repeat=3) if np.prod([2 * n + 1 for n in c]) <= max_nodes
    ]
    best = min(possible, key=lambda c: (float((edges / c).max()), float(np.prod(c))))
    return best[0], best[1], best[2]
