"""A regular mesh for a body that is a box, as test beams and cubes are, in the place of one made for any shape.

A mesh of few and irregular tetrahedra bends to one side, and its surface is not quite that of the box: of a held beam
that leaves a numerical error as large as many an effect, and a cube that falls flat tumbles after its first impact.
Cells that follow the box have neither.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from jaxtyping import Float

from physconvex.capture import Capture
from physconvex.fem import TetMesh, box_mesh

__all__ = ["box_cells", "box_of_body"]

_SAME = 2e-3  # volume missing in the box of a box, and distance of its vertices from its faces over its size
_SLENDER = 3.0  # longest edge over the others from which on one cell across is enough for quadratic elements
_FLAT = 0.4  # length of a slender box's cells over their width
_MOST = 16  # cells along an edge


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
    if abs(volume / edges.prod() - 1) > _SAME or away.max() > _SAME * edges.max():
        return None
    mesh = box_mesh((float(edges[0]), float(edges[1]), float(edges[2])), box_cells(edges, max_nodes))
    return TetMesh(mesh.vertices + low, mesh.tets)


def box_cells(edges: Float[np.ndarray, " 3"], max_nodes: int) -> tuple[int, int, int]:
    """Cells along each edge [m]: as even as so many nodes allow, of a slender box along its length alone."""
    longest, others = int(edges.argmax()), np.sort(edges)[:2]
    if edges.max() >= _SLENDER * others[1]:
        along = int(np.clip(round(edges.max() / (_FLAT * others[1])), 1, min((max_nodes // 9 - 1) // 2, _MOST)))
        cells = [1, 1, 1]
        cells[longest] = along
        return cells[0], cells[1], cells[2]
    allowed = [c for c in product(range(1, _MOST + 1), repeat=3) if np.prod([2 * n + 1 for n in c]) <= max_nodes]
    best = min(allowed, key=lambda c: (float((edges / c).max()), float(np.prod(c))))
    return best[0], best[1], best[2]
