"""fTetWild (Hu et al. 2020), which meshes any input: one checked run, and runs that coarsen to a number of nodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from physconvex.errors import ConvergenceError, InputError
from physconvex.mesh.surface_fitting import with_volume
from physconvex.mesh.surfaces import enclosed_volume
from physconvex.mesh.tet_mesh import TetMesh, compact, mean_ratios, oriented, signed_volumes, to_quadratic

# Flatter elements make the stiffness matrix ill-conditioned.
MIN_MEAN_RATIO = 0.02
# Number and factor of the coarsening steps to meet `max_nodes`.
COARSENINGS, COARSENING_FACTOR = 6, 1.35
# Share of `max_nodes` below which the mesh is refined again, and the number of refinements.
NEAR, REFINEMENTS = 0.75, 3
# Files that fTetWild always writes into the current folder.
LEFT_BEHIND = "__tracked_surface.stl"
# Volume per area of the surface, in units of fTetWild's tolerance, below which no volume is enclosed: an open sheet may
# leave a single sliver.
LEAST_THICKNESS = 0.1


class _NothingEnclosedError(InputError):
    """A mesh without the volume of its surface."""


@dataclass(frozen=True)
class Resolution:
    """Resolution of a run.

    Attributes:
        length: approximate edge length [m].
        epsilon: largest distance of the mesh from the surface, in diagonals of the surface.
        iterations: most passes of the mesh improvement.
        threads: number of threads.
    """

    length: float
    epsilon: float
    iterations: int
    threads: int = 1

    def coarser(self, factor: float) -> Resolution:
        """Edge length and tolerance multiplied by a factor."""
        return replace(self, length=self.length * factor, epsilon=self.epsilon * factor)


def fill_within(
    vertices: np.ndarray,
    faces: np.ndarray,
    resolution: Resolution,
    *,
    max_nodes: int | None,
    order: Literal[1, 2],
    match_volume: bool,
    near: bool = False,
) -> TetMesh:
    """A mesh of at most `max_nodes` nodes: edge length and tolerance grow until this is met.

    With `near` they shrink again, at most three times, if the mesh has less than three quarters of these nodes.

    Raises:
        InputError: the surface encloses no volume.
        ConvergenceError: no mesh with valid elements, or none within `max_nodes`, is found.
    """
    volume = enclosed_volume(vertices, faces) if match_volume else None

    def meshed(factor: float) -> TetMesh:
        mesh = fill(vertices, faces, resolution.coarser(factor))
        return to_quadratic(mesh) if order == 2 else mesh

    factor, sound, lost, nodes = 1.0, 1.0, np.inf, 0
    for _ in range(COARSENINGS):
        try:
            mesh = meshed(factor)
        except _NothingEnclosedError:
            if nodes == 0:
                raise
            factor, lost = float(np.sqrt(factor * sound)), factor  # thin walls: as coarse as they remain intact
            continue
        if max_nodes is None or len(mesh.vertices) <= max_nodes:
            if near and max_nodes is not None:
                mesh = _finer(mesh, factor, sound if nodes else None, max_nodes, meshed)
            return mesh if volume is None else with_volume(mesh, volume)
        nodes, sound = len(mesh.vertices), factor
        factor = min(factor * COARSENING_FACTOR, float(np.sqrt(factor * lost)))
    reached = resolution.coarser(sound).epsilon
    thin = "" if np.isinf(lost) else f" (at {resolution.coarser(lost).epsilon:.3f} its walls are lost)"
    raise ConvergenceError(
        f"tetrahedralize: still {nodes} nodes at epsilon {reached:.3f}{thin} after {COARSENINGS} attempts, "
        f"max_nodes is {max_nodes}; allow more nodes or simplify the surface"
    )


def _finer(
    mesh: TetMesh, factor: float, too_fine: float | None, max_nodes: int, meshed: Callable[[float], TetMesh]
) -> TetMesh:
    """A mesh close to `max_nodes`, or the largest of the generated ones.

    Args:
        mesh: a small one, generated with this factor on edge length and tolerance.
        factor: on edge length and tolerance.
        too_fine: a factor that gives too many nodes, if one is known.
        max_nodes: of the result.
        meshed: generates another one.
    """
    for _ in range(REFINEMENTS):
        if len(mesh.vertices) >= NEAR * max_nodes:
            break
        trial = factor / COARSENING_FACTOR if too_fine is None else float(np.sqrt(factor * too_fine))
        try:
            other = meshed(trial)
        except (ConvergenceError, InputError):
            break
        if len(other.vertices) > max_nodes:
            too_fine = trial
        else:
            factor, mesh = trial, max(mesh, other, key=lambda one: len(one.vertices))
    return mesh


def fill(vertices: np.ndarray, faces: np.ndarray, resolution: Resolution) -> TetMesh:
    """One run of fTetWild, checked."""
    import pytetwild  # here: it loads VTK, which is slow

    centre, scale = vertices.mean(axis=0), float(np.ptp(vertices, axis=0).max())
    left_behind = Path(LEFT_BEHIND).absolute()
    was_there = left_behind.exists()
    try:
        nodes, tets = pytetwild.tetrahedralize(
            (vertices - centre) / scale,
            faces,
            edge_length_abs=resolution.length / scale,
            epsilon=resolution.epsilon,
            coarsen=True,
            num_opt_iter=resolution.iterations,
            num_threads=resolution.threads,
        )
    except RuntimeError as error:
        raise ConvergenceError(f"tetrahedralize: fTetWild failed: {error}; repair or simplify the surface") from error
    finally:
        if not was_there:
            left_behind.unlink(missing_ok=True)
    nodes = np.asarray(nodes, dtype=np.float64).reshape(-1, 3)
    tets = oriented(nodes, np.asarray(tets, dtype=np.int64).reshape(-1, 4))
    least = LEAST_THICKNESS * resolution.epsilon * diagonal_of(vertices) * _area(vertices, faces)
    if signed_volumes(nodes, tets).sum() * scale**3 < least:
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


def diagonal_of(vertices: np.ndarray) -> float:
    """Diagonal of the bounding box [m]."""
    return float(np.linalg.norm(np.ptp(vertices, axis=0)))


def _area(vertices: np.ndarray, faces: np.ndarray) -> float:
    x = vertices[faces]
    return 0.5 * float(np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum())
