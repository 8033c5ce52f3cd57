"""The meshes of a refinement: the twin's, and ones of more nodes, for the last searches and to compare with.

Those of a mesher are stages: in another run it may make another mesh, to which the stored motions do not belong.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from inference.refinement.problem import material_of
from inference.refinement.stages import Arrays, RefinementRun
from physconvex import ConvergenceError
from physconvex.identify import Fit, Twin, mesh_of_capture, surface_of_capture
from physconvex.mesh import (
    TetMesh,
    filled,
    mesh_of_few_nodes,
    refine_uniformly as subdivided,
    shape_mismatch,
    tetrahedralize,
)

_FINER = 1.8  # nodes of a new mesh over those of the twin
_HARDLY = 1.2  # least gain in nodes that makes a new mesh worthwhile
_ALIKE = 0.05  # of the joint volume of body and mesh: part that belongs to only one of them
_MOST_NODES = 4000  # of tetrahedra split into eight
# most nodes of the last searches, of bodies whose E is that many times the pressure of their weight, and of softer
# ones: these rest on the floor with hundreds of points, and a roll-out takes minutes
_STIFF, _OF_STIFF, _OF_SOFT = 30.0, 2400, 1400


def twin_mesh(run: RefinementRun) -> TetMesh:
    """The twin's quadratic mesh, see `physconvex.identify.mesh_of_capture`; filled if the options say so.

    Raises:
        InputError, ConvergenceError: there is none.
    """
    capture, options = run.capture, run.options
    if capture.tets() is not None:  # usually taken as they are
        return mesh_of_capture(capture, max_nodes=options.max_nodes, fill=options.fill)
    mesh = _kept(run, "mesh", lambda: mesh_of_capture(capture, max_nodes=options.max_nodes))
    surface = surface_of_capture(capture)
    assert mesh is not None and surface is not None
    return filled(mesh, *surface) if options.fill else mesh


def comparison_mesh(run: RefinementRun, twin: Twin) -> TetMesh | None:
    """A finer quadratic mesh of the same body, or None if none is small enough.

    Tetrahedra of the capture are split into eight each, which keeps the geometry. A mesh made of the capture's surface
    is replaced by one with 1.8 times the nodes, which is filled if the twin's is.
    """
    if is_of_capture(twin):
        fine = subdivided(twin.mesh)
        return fine if len(fine.vertices) <= _MOST_NODES else None
    surface = surface_of_capture(twin.capture)
    if surface is None:
        return None

    def make() -> TetMesh | None:
        try:
            return mesh_of_few_nodes(*surface, max_nodes=int(_FINER * len(twin.mesh.vertices)))
        except ConvergenceError:
            return None

    return _filled_alike(_kept(run, "comparison_mesh", make), twin, surface)


def fine_mesh(run: RefinementRun, twin: Twin, found: Fit) -> TetMesh | None:
    """The mesh of the last searches, for a body that hits something: with few nodes it rebounds differently.

    The best result of several meshers on the capture's surface, with at most `fine_nodes` nodes (of the options), or
    else 2,400, or 1,400 if E is less than 30 ρ g L at the fit. None if there is no contact, if the twin's mesh matches
    the body (within a twentieth of their volume), or if no mesh with more nodes is found.
    """
    surface = None if is_of_capture(twin) else surface_of_capture(twin.capture)
    if not twin.may_strike or surface is None:
        return None
    nodes = _affordable(twin, found) if run.options.fine_nodes is None else run.options.fine_nodes
    if nodes <= run.options.max_nodes:
        return None
    if shape_mismatch(twin.mesh, *surface) < _ALIKE:
        return None

    def make() -> TetMesh | None:
        try:
            return tetrahedralize(surface, max_nodes=nodes, order=2, method="auto", thorough=True)
        except ConvergenceError:
            return None

    return _filled_alike(_kept(run, "fine_mesh", make), twin, surface)


def _kept(run: RefinementRun, name: str, make: Callable[[], TetMesh | None]) -> TetMesh | None:
    """The mesh of a stage."""

    def compute() -> Arrays:
        mesh = make()
        if mesh is None:
            return {"vertices": np.zeros((0, 3)), "tets": np.zeros((0, 10), dtype=np.int64)}
        return {"vertices": mesh.vertices, "tets": mesh.tets}

    arrays = run.stages.run(name, compute)
    return TetMesh(arrays["vertices"], arrays["tets"]) if len(arrays["tets"]) else None


def _affordable(twin: Twin, found: Fit) -> int:
    modulus, density = material_of(twin, found)
    weight = density * float(np.linalg.norm(twin.scene.gravity)) * twin.mesh.size
    return _OF_STIFF if 10.0**modulus >= _STIFF * weight else _OF_SOFT


def is_of_capture(twin: Twin) -> bool:
    """Whether the twin's tetrahedra are those of the capture."""
    tets = twin.capture.tets()
    return tets is not None and np.array_equal(twin.mesh.vertices[: len(tets.vertices)], tets.vertices)


def _filled_alike(fine: TetMesh | None, twin: Twin, surface: tuple[np.ndarray, np.ndarray]) -> TetMesh | None:
    """Filled if the twin's mesh is; None where there is none, or one of hardly more nodes."""
    if fine is None or len(fine.vertices) <= _HARDLY * len(twin.mesh.vertices):
        return None
    return fine if twin.mesh.filling is None else filled(fine, *surface)
