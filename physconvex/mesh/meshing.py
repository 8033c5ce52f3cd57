"""Tetrahedral meshes of the interior of any triangle surface.

fTetWild (Hu et al. 2020) accepts every input, but its results differ from run to run. The lattice mesher
(`implicit_meshing`) needs a closed surface and is exactly reproducible, but with few nodes it loses thin parts and
thickens others. Thin-walled surfaces are simplified first.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from physconvex.errors import ConvergenceError, InputError
from physconvex.mesh.embedding import locate
from physconvex.mesh.ftetwild import Resolution, diagonal_of, fill, fill_within
from physconvex.mesh.implicit_meshing import tetrahedralize_implicit
from physconvex.mesh.mesh_cache import cached_mesh, cached_or_made
from physconvex.mesh.stuffing import SignedDistance
from physconvex.mesh.surface_fitting import with_volume
from physconvex.mesh.surfaces import enclosed_volume, overlap, simplified_within, surface_distance, with_fewer_triangles
from physconvex.mesh.tet_mesh import TetMesh, to_quadratic

# Share of the joint volume of body and mesh in both: sufficient for the lattice's mesh, and for fTetWild's.
ENOUGH, ALMOST = 0.9, 0.8
# Of meshes of a simplified surface: nodes of the result for each triangle by order, distance from those triangles over
# the diagonal, number of coarser trials, and number of small meshes if the first has less than ENOUGH of the body:
# fTetWild gives another one each time, of a slab on legs with 0.88 to 0.99.
NODES_PER_TRIANGLE, SIMPLIFIED_EPSILON, SIMPLIFICATIONS, DRAWS = {1: 0.7, 2: 3.2}, 0.01, 6, 4
# Of meshes of few nodes: factors on the requested number; sufficient mismatch, as a share of the volume, and as one of
# the size if the surface is open; vertices at which that is measured.
_GROWTH, _GOOD, _GOOD_OPEN, _SAMPLES = (1.0, 2.0), 0.25, 0.03, 600
# Triangles of a closed surface above which it is simplified before, within this share of its diagonal: a tenth of what
# the meshers do to it, and a third of their time.
_DENSE, _SIMPLIFIED_WITHIN = 20_000, 0.002


@runtime_checkable
class TriangleSurface(Protocol):
    """Anything with triangles, for example `trimesh.Trimesh`."""

    @property
    def vertices(self) -> np.ndarray:
        """Positions [m], shape [V, 3]."""

    @property
    def faces(self) -> np.ndarray:
        """Vertex indices, shape [F, 3]."""


def tetrahedralize(
    surface: TriangleSurface | tuple[np.ndarray, np.ndarray],
    *,
    target_edge_length: float | None = None,
    epsilon: float = 0.02,
    max_nodes: int | None = None,
    order: Literal[1, 2] = 1,
    method: Literal["auto", "ftetwild", "lattice", "simplified"] = "ftetwild",
    signed_distance: SignedDistance | None = None,
    match_volume: bool = True,
    thorough: bool = False,
    max_iterations: int = 80,
    threads: int = 1,
) -> TetMesh:
    """Fill a triangle surface with tetrahedra.

    With `method="ftetwild"` the surface may have holes, several components and self-intersections: the inside is where
    its generalised winding number exceeds one half. The mesh differs a little from run to run (also with one thread).
    With `method="lattice"` equal arguments give equal meshes; the surface must be closed. `method="simplified"` fills a
    simplified closed surface of few triangles by fTetWild. `method="auto"` takes the lattice if it succeeds and shares
    enough of its volume with the body (`overlap`). Otherwise it takes the better one of the lattice
    and fTetWild, and also tries the simplified surface if both lose much. Meshes of fTetWild are kept in the cache
    folder (`physconvex.kernels.build.cache_folder`), so that they are reproducible.

    Args:
        surface: an object with `vertices` and `faces`, or the pair (vertices [V, 3] in metres, faces [F, 3]).
        target_edge_length: edge length where the geometry needs nothing finer [m]; default: a tenth of the diagonal of
            the bounding box. fTetWild only.
        epsilon: largest distance of the mesh boundary from the surface (before `match_volume`), relative to the
            diagonal of the bounding box. It affects the number of nodes more than `target_edge_length` does. fTetWild
            only.
        max_nodes: upper bound on the nodes of the result; edge length and epsilon grow until it is met. The lattice
            mesher always has such a bound, 700 by default, and comes close to it, as does fTetWild under "auto".
        order: 1 for linear, 2 for quadratic elements.
        method: the mesher.
        signed_distance: negative inside [m], if available; else the lattice mesher computes it.
        match_volume: for closed surfaces, move the boundary nodes along their normals so that the mesh has the volume
            of the surface (coarse meshes cut corners and are several per cent too small otherwise). The lattice mesher
            always does so.
        thorough: try all three methods and take the best. "auto" only.
        max_iterations: most passes of the mesh improvement of fTetWild.
        threads: threads of fTetWild.

    Returns:
        Mesh with positively oriented elements.

    Raises:
        InputError: the arguments are wrong, or the surface encloses no volume.
        ConvergenceError: no mesh with valid elements, or none within `max_nodes`, is found.
    """
    vertices, faces = _checked_surface(surface)
    length = 0.1 * diagonal_of(vertices) if target_edge_length is None else float(target_edge_length)
    if not 0 < length < np.inf:
        raise InputError(f"target_edge_length: got {target_edge_length}; expected a positive length in metres")
    if not 0 < epsilon < 0.5:
        raise InputError(f"epsilon: got {epsilon}; expected a fraction of the diagonal in (0, 0.5)")
    if order not in (1, 2):
        raise InputError(f"order: got {order!r}; expected 1 or 2")
    if method not in ("auto", "ftetwild", "lattice", "simplified"):
        raise InputError(f"method: got {method!r}; expected 'auto', 'ftetwild', 'lattice' or 'simplified'")
    limit = 700 if max_nodes is None else max_nodes
    ways: dict[str, Callable[[], TetMesh]] = {
        "lattice": partial(_lattice_mesh, vertices, faces, signed_distance, limit, order),
        "ftetwild": partial(
            fill_within,
            vertices,
            faces,
            Resolution(length, epsilon, max_iterations, threads),
            max_nodes=max_nodes,
            order=order,
            match_volume=match_volume,
            near=method == "auto",
        ),
        "simplified": partial(_simplified_mesh, vertices, faces, limit, order),
    }
    if method != "auto":
        return ways[method]()
    settings = (length, epsilon, max_nodes, order, match_volume, thorough, max_iterations)
    return _best_mesh(vertices, faces, ways, thorough, settings)


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
    found: list[tuple[float, TetMesh]] = []
    failures: list[ConvergenceError] = []
    volume = enclosed_volume(vertices, triangles)
    good = _GOOD if volume is not None else _GOOD_OPEN
    dense = volume is not None and len(triangles) > _DENSE
    if dense:
        vertices, triangles = simplified_within(vertices, triangles, _SIMPLIFIED_WITHIN * diagonal_of(vertices))
    for growth in _GROWTH:
        try:
            mesh = tetrahedralize((vertices, triangles), max_nodes=round(growth * max_nodes), order=2, method="auto")
        except ConvergenceError as error:
            failures.append(error)
            continue
        found.append((shape_mismatch(mesh, vertices, triangles), mesh))
        if found[-1][0] < good:
            break
    if not found:
        raise failures[-1]
    best = min(found, key=lambda pair: pair[0])[1]
    return with_volume(best, volume) if dense and volume is not None else best


def shape_mismatch(mesh: TetMesh, vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"]) -> float:
    """Share of the joint volume of body and mesh that belongs to only one of them.

    For an open surface: the rms distance of its vertices from the mesh, relative to its size.
    """
    if enclosed_volume(vertices, triangles) is not None:
        return 1.0 - overlap(mesh, vertices, triangles)
    stride = max(1, len(vertices) // _SAMPLES)
    away = locate(mesh, vertices[np.unique(triangles)][::stride])[3]
    return float(np.sqrt(np.square(away).mean())) / float(np.ptp(vertices, axis=0).max())


def _best_mesh(
    vertices: np.ndarray, faces: np.ndarray, ways: dict[str, Callable[[], TetMesh]], thorough: bool, settings: object
) -> TetMesh:
    """The lattice's mesh if it is good enough, else the best of all; fTetWild's if the surface is open."""
    if enclosed_volume(vertices, faces) is None:
        return ways["ftetwild"]()
    before = cached_mesh((vertices, faces), settings)
    if before is not None:
        return before
    found: list[tuple[float, TetMesh]] = []
    failures: list[Exception] = []

    def reached(name: str, wanted: float) -> bool:
        try:
            mesh = ways[name]()
        except (InputError, ConvergenceError) as error:
            failures.append(error)
        else:
            found.append((overlap(mesh, vertices, faces), mesh))
        return not thorough and max((share for share, _ in found), default=0.0) >= wanted

    def best_of_others() -> TetMesh:
        _ = reached("ftetwild", ALMOST) or reached("simplified", ALMOST)
        if not found:
            raise failures[1]
        return max(found, key=lambda pair: pair[0])[1]

    return found[0][1] if reached("lattice", ENOUGH) else cached_or_made((vertices, faces), settings, best_of_others)


def _simplified_mesh(vertices: np.ndarray, faces: np.ndarray, max_nodes: int, order: Literal[1, 2]) -> TetMesh:
    """A simplified surface of few triangles, with its interior filled closely."""
    volume = _volume_inside(vertices, faces)
    settings, nodes = [(max_nodes / NODES_PER_TRIANGLE[order], SIMPLIFIED_EPSILON)], 0
    found: list[tuple[float, TetMesh]] = []
    for _ in range(SIMPLIFICATIONS + DRAWS):
        triangles, epsilon = settings[-1]
        coarse = with_fewer_triangles(vertices, faces, max(int(triangles), 20))
        mesh = fill(*coarse, Resolution(0.5 * diagonal_of(vertices), epsilon, iterations=20))
        mesh = to_quadratic(mesh) if order == 2 else mesh
        nodes = len(mesh.vertices)
        if nodes > max_nodes:
            if len(settings) == SIMPLIFICATIONS:
                break
            settings.append((triangles * min(0.8, max_nodes / nodes), 1.5 * epsilon))
            continue
        mesh = with_volume(mesh, volume)
        found.append((overlap(mesh, vertices, faces), mesh))
        if found[-1][0] >= ENOUGH or len(found) == DRAWS:
            break
        if len(settings) > 1:  # the finer one may have too many nodes by chance
            settings.pop()
    if found:
        return max(found, key=lambda one: one[0])[1]
    raise ConvergenceError(
        f"tetrahedralize: still {nodes} nodes after {SIMPLIFICATIONS} simplifications, max_nodes is {max_nodes}; "
        "allow more nodes"
    )


def _volume_inside(vertices: np.ndarray, faces: np.ndarray) -> float:
    volume = enclosed_volume(vertices, faces)
    if volume is None:
        raise InputError('surface: open or inside out; close it and orient it outwards, or use method="ftetwild"')
    return volume


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
    _volume_inside(vertices, faces)
    field = surface_distance(vertices, faces) if signed_distance is None else signed_distance
    bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    return tetrahedralize_implicit(field, bounds, surface=(vertices, faces), max_nodes=max_nodes, order=order)


def _checked_surface(surface: TriangleSurface | tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
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
