"""Signed distance from closed triangle surfaces, and overlap of a mesh with the volume that a surface encloses."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from physconvex.mesh.embedding import contains
from physconvex.mesh.stuffing import SignedDistance
from physconvex.mesh.surfaces import with_merged_vertices
from physconvex.mesh.tet_mesh import TetMesh

_SAMPLES = 20_000


def surface_distance(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> SignedDistance:
    """Signed distance from a closed, outward oriented surface, negative inside."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

    vertices, faces = with_merged_vertices(vertices, faces)
    points, cells, data = vtk.vtkPoints(), vtk.vtkCellArray(), vtk.vtkPolyData()
    points.SetData(numpy_to_vtk(vertices, deep=True))
    cells.SetData(3, numpy_to_vtkIdTypeArray(faces.astype(np.int64).ravel(), deep=True))
    data.SetPoints(points)
    data.SetPolys(cells)
    distance = vtk.vtkImplicitPolyDataDistance()
    distance.SetInput(data)

    def field(p: np.ndarray) -> np.ndarray:
        result = vtk.vtkDoubleArray()
        distance.FunctionValue(numpy_to_vtk(np.ascontiguousarray(p, dtype=np.float64), deep=True), result)
        return vtk_to_numpy(result).copy()

    return field


def overlap(mesh: TetMesh, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> float:
    """Volume of the intersection of a mesh and the interior of a closed surface, over that of their union.

    Estimated with 20,000 fixed points: the error is about 0.005.
    """
    low = np.minimum(vertices[np.unique(faces)].min(axis=0), mesh.vertices.min(axis=0))
    high = np.maximum(vertices[np.unique(faces)].max(axis=0), mesh.vertices.max(axis=0))
    points = np.random.default_rng(0).uniform(low, high, (_SAMPLES, 3))
    wanted = surface_distance(vertices, faces)(points) < 0
    meshed = contains(mesh, points)
    both = float((wanted | meshed).sum())
    return float((wanted & meshed).sum()) / both if both else 0.0
