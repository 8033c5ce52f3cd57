"""Meshes of more nodes: for the last searches, and to compare with."""

from __future__ import annotations

import numpy as np

from inference.refinement.problem import material_of
from inference.refinement.run import RefinementRun
from inference.refinement.stages import Arrays
from physconvex import ConvergenceError
from physconvex.identify import Fit, Twin, surface_of_capture
from physconvex.mesh import (
    TetMesh,
    filled,
    mesh_of_few_nodes,
    refine_uniformly as subdivided,
    shape_mismatch,
    tetrahedralize,
)

_FINER = 1.8  # nodes of a mesh made anew over those of the twin
_HARDLY = 1.2  # times the nodes: no more is gained
_ALIKE = 0.05  # of the volume of body and mesh together, that only one of them has
_MOST_NODES = 4000  # of tetrahedra cut in eight
# most nodes of the last searches, of bodies of so many times their own weight's pressure and of softer ones: these lie
# on the floor with hundreds of points, and a roll-out takes minutes
_STIFF, _OF_STIFF, _OF_SOFT = 30.0, 2400, 1400


def comparison_mesh(twin: Twin) -> TetMesh | None:
    """A finer quadratic mesh of the same body, or None where none is found that is small enough.

    Tetrahedra of the capture are cut in eight each, which keeps the geometry; a mesh that was made from the capture's
    surface is made again with 1.8 times the nodes, and filled if the twin's is.
    """
    if is_of_capture(twin):
        fine = subdivided(twin.mesh)
        return fine if len(fine.vertices) <= _MOST_NODES else None
    surface = surface_of_capture(twin.capture)
    if surface is None:
        return None
    try:
        fine = mesh_of_few_nodes(*surface, max_nodes=int(_FINER * len(twin.mesh.vertices)))
    except ConvergenceError:
        return None
    return _filled_alike(fine, twin, surface)


def fine_mesh(run: RefinementRun, twin: Twin, found: Fit) -> TetMesh | None:
    """That of the last searches of a body that strikes something, which of few nodes rebounds otherwise.

    The best that is found, of several meshers, with at most `fine_nodes` nodes (of the options), or else 2,400, or
    1,400 where E is less than 30 ρ g L at the fit that was found; it is made anew from the surface of the capture.
    None where nothing is struck, the twin's mesh is all but the body (a twentieth of their volume apart), or no mesh
    with more nodes is found.
    """
    surface = None if is_of_capture(twin) else surface_of_capture(twin.capture)
    if not twin.may_strike or surface is None:
        return None
    nodes = _affordable(twin, found) if run.options.fine_nodes is None else run.options.fine_nodes
    if nodes <= run.options.max_nodes:
        return None
    if shape_mismatch(twin.mesh, *surface) < _ALIKE:
        return None

    def compute() -> Arrays:
        try:
            mesh = tetrahedralize(surface, max_nodes=nodes, order=2, method="auto", thorough=True)
        except ConvergenceError:
            return {"vertices": np.zeros((0, 3)), "tets": np.zeros((0, 10), dtype=np.int64)}
        return {"vertices": mesh.vertices, "tets": mesh.tets}

    arrays = run.stages.run("fine_mesh", compute)
    return _filled_alike(TetMesh(arrays["vertices"], arrays["tets"]), twin, surface) if len(arrays["tets"]) else None


def _affordable(twin: Twin, found: Fit) -> int:
    modulus, density = material_of(twin, found)
    weight = density * float(np.linalg.norm(twin.scene.gravity)) * twin.mesh.size
    return _OF_STIFF if 10.0**modulus >= _STIFF * weight else _OF_SOFT


def is_of_capture(twin: Twin) -> bool:
    """Whether the twin's tetrahedra are those of the capture."""
    tets = twin.capture.tets()
    return tets is not None and np.array_equal(twin.mesh.vertices[: len(tets.vertices)], tets.vertices)


def _filled_alike(fine: TetMesh, twin: Twin, surface: tuple[np.ndarray, np.ndarray]) -> TetMesh | None:
    """Filled if the twin's mesh is; None where it has hardly more nodes."""
    if len(fine.vertices) <= _HARDLY * len(twin.mesh.vertices):
        return None
    return fine if twin.mesh.filling is None else filled(fine, *surface)
