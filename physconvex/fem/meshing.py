"""Tetrahedral meshes of the inside of any triangle surface.

Two ways: fTetWild (Hu et al. 2020) takes everything, but its results differ from run to run; the lattice mesher
(`implicit_meshing`) wants a closed surface without very thin parts and repeats itself to the bit.
"""

from __future__ import annotations

from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from physconvex.errors import ConvergenceError, InputError
from physconvex.fem.implicit_meshing import tetrahedralize_implicit
from physconvex.fem.mesh import TetMesh, compact, to_quadratic
from physconvex.fem.mesh_volume import enclosed_volume, with_volume
from physconvex.fem.quality import mean_ratios
from physconvex.fem.stuffing import SignedDistance

__all__ = ["Surface", "tetrahedralize", "tetrahedralize_implicit"]

# Elements flatter than this would ruin the conditioning of the stiffness matrix.
MIN_MEAN_RATIO = 0.02
# How often the resolution is made coarser to respect `max_nodes`, and by how much.
COARSENINGS, COARSENING_FACTOR = 6, 1.35
# Volume per area of the surface, in units of fTetWild's tolerance, below which nothing was enclosed: a single sliver
# may be left of an open sheet.
LEAST_THICKNESS = 0.1


@runtime_checkable
class Surface(Protocol):
    """Anything with triangles, for example `trimesh.Trimesh`."""

    @property
    def vertices(self) -> np.ndarray:
        """Positions [m], shape [V, 3]."""

    @property
    def faces(self) -> np.ndarray:
        """Vertex indices, shape [F, 3]."""


def tetrahedralize(
    surface: Surface | tuple[np.ndarray, np.ndarray],
    *,
    target_edge_length: float | None = None,
    epsilon: float = 0.02,
    max_nodes: int | None = None,
    order: Literal[1, 2] = 1,
    method: Literal["auto", "ftetwild", "lattice"] = "ftetwild",
    signed_distance: SignedDistance | None = None,
    match_volume: bool = True,
    max_iterations: int = 80,
    threads: int = 1,
) -> TetMesh:
    """Fill a triangle surface with tetrahedra.

    With `method="ftetwild"` the surface may have holes, several components and self-intersections: the inside is where
    its generalised winding number exceeds one half. The mesh differs a little from run to run (a trait of fTetWild,
    also with one thread). With `method="lattice"` equal arguments give equal meshes; the surface must be closed.
    `method="auto"` takes the lattice where that succeeds and fTetWild elsewhere.

    Args:
        surface: an object with `vertices` and `faces`, or the pair (vertices [V, 3] in metres, faces [F, 3]).
        target_edge_length: edge length aimed at where the geometry asks for nothing finer [m];
            default: a tenth of the diagonal of the bounding box. fTetWild only.
        epsilon: largest distance of the mesh boundary from the surface (before `match_volume`), relative to the
            diagonal of the bounding box. It governs the number of nodes more than `target_edge_length` does.
            fTetWild only.
        max_nodes: upper bound on the nodes of the result; edge length and epsilon grow until it is met. The lattice
            mesher always has such a bound, 700 by default, and comes close to it.
        order: 1 for linear, 2 for quadratic elements.
        method: the mesher.
        signed_distance: negative inside [m], if it is at hand; the lattice mesher computes it otherwise.
        match_volume: for closed surfaces, move the boundary nodes along their normals so that the mesh has the volume
            of the surface (coarse meshes cut corners and would be several per cent too small). The lattice mesher
            always does so.
        max_iterations: most passes of the mesh improvement of fTetWild.
        threads: threads of fTetWild.

    Returns:
        Mesh with positively oriented elements.

    Raises:
        InputError: the arguments are wrong, or the surface encloses no volume.
        ConvergenceError: no mesh with sound elements, or none within `max_nodes`, was found.
    """
    vertices, faces = _checked_surface(surface)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    length = 0.1 * diagonal if target_edge_length is None else float(target_edge_length)
    if not 0 < length < np.inf:
        raise InputError(f"target_edge_length: got {target_edge_length}; expected a positive length in metres")
    if not 0 < epsilon < 0.5:
        raise InputError(f"epsilon: got {epsilon}; expected a fraction of the diagonal in (0, 0.5)")
    if order not in (1, 2):
        raise InputError(f"order: got {order!r}; expected 1 or 2")
    if method not in ("auto", "ftetwild", "lattice"):
        raise InputError(f"method: got {method!r}; expected 'auto', 'ftetwild' or 'lattice'")
    if method != "ftetwild":
        try:
            return _lattice_mesh(vertices, faces, signed_distance, 700 if max_nodes is None else max_nodes, order)
        except (InputError, ConvergenceError):
            if method == "lattice":
                raise
    volume = enclosed_volume(vertices, faces) if match_volume else None
    factor, sound, lost, nodes = 1.0, 1.0, np.inf, 0
    for _ in range(COARSENINGS):
        try:
            mesh = _mesh_once(vertices, faces, length * factor, epsilon * factor, max_iterations, threads)
        except _NothingEnclosedError:
            if nodes == 0:
                raise
            factor, lost = float(np.sqrt(factor * sound)), factor  # thin walls: as coarse as they stand
            continue
        mesh = to_quadratic(mesh) if order == 2 else mesh
        if max_nodes is None or len(mesh.vertices) <= max_nodes:
            return mesh if volume is None else with_volume(mesh, volume)
        nodes, sound = len(mesh.vertices), factor
        factor = min(factor * COARSENING_FACTOR, float(np.sqrt(factor * lost)))
    thin = "" if np.isinf(lost) else f" (at {epsilon * lost:.3f} its walls are lost)"
    raise ConvergenceError(
        f"tetrahedralize: still {nodes} nodes at epsilon {epsilon * sound:.3f}{thin} after {COARSENINGS} attempts, "
        f"max_nodes is {max_nodes}; allow more nodes or simplify the surface"
    )


class _NothingEnclosedError(InputError):
    """A mesh without the volume of its surface."""


def _lattice_mesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    signed_distance: SignedDistance | None,
    max_nodes: int,
    order: Literal[1, 2],
) -> TetMesh:
    """Mesh of a closed surface by the lattice mesher."""
    used, index = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], index.reshape(-1, 3)
    if enclosed_volume(vertices, faces) is None:
        raise InputError('surface: open or inside out; close it and orient it outwards, or use method="ftetwild"')
    field = surface_distance(vertices, faces) if signed_distance is None else signed_distance
    bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    return tetrahedralize_implicit(field, bounds, surface=(vertices, faces), max_nodes=max_nodes, order=order)


def surface_distance(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> SignedDistance:
    """Signed distance from a closed, outward oriented surface, negative inside."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

    vertices, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
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


def _checked_surface(surface: Surface | tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (float64) and faces (int32) of the argument, or an InputError."""
    pair = surface if isinstance(surface, tuple) else (surface.vertices, surface.faces)
    vertices, faces = np.asarray(pair[0], dtype=np.float64), np.asarray(pair[1])
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise InputError(f"surface: vertices of shape {vertices.shape}; expected finite [V, 3] in metres")
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) < 4 or not np.issubdtype(faces.dtype, np.integer):
        raise InputError(
            f"surface: faces of shape {faces.shape}, {faces.dtype}; expected at least four triangles [F, 3] "
            "of integers; triangulate polygons before"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"surface: face indices {faces.min()}..{faces.max()}; expected 0..{len(vertices) - 1}")
    used = vertices[faces].reshape(-1, 3)
    if np.ptp(used, axis=0).min() <= 1e-9 * np.ptp(used, axis=0).max():
        raise InputError(f"surface: extent {np.ptp(used, axis=0)} m is flat; expected a body with a volume")
    return np.ascontiguousarray(vertices), np.ascontiguousarray(faces, dtype=np.int32)


def _mesh_once(
    vertices: np.ndarray, faces: np.ndarray, length: float, epsilon: float, iterations: int, threads: int
) -> TetMesh:
    """One run of fTetWild, checked."""
    import pytetwild  # here: it loads VTK, which takes a while

    centre, scale = vertices.mean(axis=0), float(np.ptp(vertices, axis=0).max())
    try:
        nodes, tets = pytetwild.tetrahedralize(
            (vertices - centre) / scale,
            faces,
            edge_length_abs=length / scale,
            epsilon=epsilon,
            coarsen=True,
            num_opt_iter=iterations,
            num_threads=threads,
        )
    except RuntimeError as error:
        raise ConvergenceError(f"tetrahedralize: fTetWild failed: {error}; repair or simplify the surface") from error
    nodes = np.asarray(nodes, dtype=np.float64).reshape(-1, 3)
    tets = _positive(nodes, np.asarray(tets, dtype=np.int64).reshape(-1, 4))
    if _volume(nodes, tets) * scale**3 < LEAST_THICKNESS * epsilon * _diagonal(vertices) * _area(vertices, faces):
        raise _NothingEnclosedError(
            "surface: it encloses no volume that a mesh of this resolution could fill; "
            "close its holes, orient its faces outwards, or lower epsilon"
        )
    ratios = mean_ratios(nodes, tets)
    if ratios.min() < MIN_MEAN_RATIO:
        raise ConvergenceError(
            f"tetrahedralize: {np.sum(ratios < MIN_MEAN_RATIO)} of {len(tets)} elements are flat (mean ratio "
            f"{ratios.min():.1e}); try another target_edge_length or epsilon, or raise max_iterations"
        )
    return compact(nodes * scale + centre, tets)


def _volume(vertices: np.ndarray, tets: np.ndarray) -> float:
    x = vertices[tets]
    return float(np.linalg.det(x[:, 1:] - x[:, :1]).sum()) / 6.0


def _diagonal(vertices: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(vertices, axis=0)))


def _area(vertices: np.ndarray, faces: np.ndarray) -> float:
    x = vertices[faces]
    return 0.5 * float(np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum())


def _positive(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The tetrahedra with two corners swapped wherever the orientation is negative."""
    x = vertices[tets]
    negative = np.linalg.det(x[:, 1:] - x[:, :1]) < 0
    return np.where(negative[:, None], tets[:, [0, 2, 1, 3]], tets)
