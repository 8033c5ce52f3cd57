"""Meshes of few tetrahedra that still represent the body, selected by their overlap with its surface."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from physconvex.errors import ConvergenceError
from physconvex.mesh.embedding import locate
from physconvex.mesh.meshing import tetrahedralize
from physconvex.mesh.signed_distance import overlap
from physconvex.mesh.surfaces import enclosed_volume
from physconvex.mesh.tet_mesh import TetMesh

_GROWTH = (1.0, 2.0)  # factors on the requested number of nodes
_GOOD, _GOOD_OPEN = 0.25, 0.03  # of the volume; of the size, if the surface is open
_SAMPLES = 600


def mesh_of_few_nodes(
    vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"], *, max_nodes: int
) -> TetMesh:
    """Quadratic tetrahedra of a surface with at most `max_nodes` nodes, or more if this loses parts of the body.

    Meshes that are too coarse lose thin parts. In this case up to twice the nodes are tried. The first mesh that is
    accurate enough is taken, else the most accurate one.

    Raises:
        InputError: the surface encloses no volume.
        ConvergenceError: no mesh is found.
    """
    best: tuple[float, TetMesh] | None = None
    failure: ConvergenceError | None = None
    good = _GOOD if enclosed_volume(vertices, triangles) is not None else _GOOD_OPEN
    for growth in _GROWTH:
        try:
            mesh = tetrahedralize((vertices, triangles), max_nodes=round(growth * max_nodes), order=2, method="auto")
        except ConvergenceError as error:
            failure = error
            continue
        wrong = shape_mismatch(mesh, vertices, triangles)
        if best is None or wrong < best[0]:
            best = (wrong, mesh)
        if wrong < good:
            break
    if best is None:
        assert failure is not None
        raise failure
    return best[1]


def shape_mismatch(mesh: TetMesh, vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"]) -> float:
    """Share of the joint volume of body and mesh that belongs to only one of them.

    For an open surface: the rms distance of its vertices from the mesh, relative to its size.
    """
    if enclosed_volume(vertices, triangles) is not None:
        return 1.0 - overlap(mesh, vertices, triangles)
    stride = max(1, len(vertices) // _SAMPLES)
    away = locate(mesh, vertices[np.unique(triangles)][::stride])[3]
    return float(np.sqrt(np.square(away).mean())) / float(np.ptp(vertices, axis=0).max())
