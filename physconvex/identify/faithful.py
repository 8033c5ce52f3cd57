"""Few tetrahedra that still are the body: meshes of a surface judged by how far they lie from it."""

from __future__ import annotations

import numpy as np
import trimesh
from jaxtyping import Float, Int

from physconvex.errors import ConvergenceError
from physconvex.fem import TetMesh
from physconvex.fem.embedding import locate
from physconvex.fem.meshing import tetrahedralize

__all__ = ["faithful_mesh", "unfaithfulness"]

_GROWTH = (1.0, 1.4, 2.0)  # of the number of nodes asked for
_GOOD = 0.03
_SAMPLES = 600


def faithful_mesh(vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"], *, max_nodes: int) -> TetMesh:
    """Quadratic tetrahedra of a surface with at most `max_nodes` nodes, or more where so few lose parts of the body.

    Thin parts vanish from meshes that are too coarse for them. Up to twice the nodes are tried then, and the
    first mesh is taken that is faithful enough, else the most faithful one.

    Raises:
        InputError: the surface encloses no volume.
        ConvergenceError: no mesh was found.
    """
    best: tuple[float, TetMesh] | None = None
    failure: ConvergenceError | None = None
    for growth in _GROWTH:
        try:
            mesh = tetrahedralize((vertices, triangles), max_nodes=round(growth * max_nodes), order=2, method="auto")
        except ConvergenceError as error:
            failure = error
            continue
        wrong = unfaithfulness(mesh, vertices, triangles)
        if best is None or wrong < best[0]:
            best = (wrong, mesh)
        if wrong < _GOOD:
            break
    if best is None:
        assert failure is not None
        raise failure
    return best[1]


def unfaithfulness(mesh: TetMesh, vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"]) -> float:
    """Rms distance of the surface's vertices to the body, in its size, plus a tenth of the relative error of volume."""
    stride = max(1, len(vertices) // _SAMPLES)
    away = locate(mesh, vertices[np.unique(triangles)][::stride])[3]
    surface = trimesh.Trimesh(vertices, triangles, process=False)
    size = float(np.ptp(vertices, axis=0).max())
    volume = abs(mesh.volume / surface.volume - 1) if surface.is_watertight and surface.volume > 0 else 0.0
    return float(np.sqrt(np.square(away).mean())) / size + 0.1 * volume
