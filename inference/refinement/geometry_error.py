"""How far errors of a reconstructed body move the estimates: its surface is displaced, and the residuals change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import cKDTree

from inference.refinement.stages import Arrays, RefinementRun
from physconvex import ConvergenceError
from physconvex.fem import SurfacePoints
from physconvex.identify import Fit, FullModel, Observations, parameter_shifts, roll_out_together
from physconvex.mesh import filled
from physconvex.reconstruction import SurfaceError

_DRAWS = 2  # of local errors
_MOST = 0.02  # of the size: a greater displacement is shortened, and its effect enlarged alike


def geometry_error(
    run: RefinementRun, full: FullModel, found: Fit, seen: Observations
) -> Float[np.ndarray, " K"] | None:
    """Standard deviation of each value by the error of the reconstructed body.

    None with a given geometry; NaN, unknown, where the quick answer of an early stage is asked for.

    The full model is rolled out on the twin's mesh, filled by the surface and by displaced ones. To first order, the
    differences of the residuals move the values.

    Args:
        run: the refinement.
        full: the fitted model.
        found: the fit.
        seen: the observations.
    """
    made = run.reconstruction
    if made is None or made.body is None or made.error is None:
        return None
    body, error = made.body, made.error
    if run.options.stop_after is not None:
        return np.full(len(found.values), np.nan)

    def compute() -> Arrays:
        parts = parameter_errors(replace(full, points=seen.points), found, seen, body, error)
        return {"sigma": np.sqrt(np.square(parts).sum(axis=0))}

    try:
        return run.stages.run("geometry_error", compute)["sigma"]
    except ConvergenceError as failure:
        run.warnings.append(f"The error of the reconstructed body is unknown: a displaced body failed ({failure}).")
        return np.full(len(found.values), np.nan)


def parameter_errors(
    full: FullModel, found: Fit, seen: Observations, body: trimesh.Trimesh, error: SurfaceError
) -> Float[np.ndarray, "D K"]:
    """Standard deviation of each fitted value by each independent displacement of the body's surface.

    Args:
        full: the fitted model, of the observed points.
        found: the fit.
        seen: the observations.
        body: the surface of the twin.
        error: that of the surface.

    Raises:
        ConvergenceError: a displaced body cannot be simulated.
    """
    vertices = np.asarray(body.vertices, dtype=np.float64)
    modes = error.displacements(vertices, draws=_DRAWS, generator=np.random.default_rng(0))
    scales = [max(1.0, float(np.abs(by).max()) / (_MOST * full.twin.mesh.size)) for _, by in modes]
    moved = [by / scale for (_, by), scale in zip(modes, scales, strict=True)]
    models = [displaced(full, body, by) for by in (np.zeros(len(vertices)), *moved)]
    roll_out_together([(model, found.values) for model in models])
    base, *others = (seen.residuals(model.positions(found.values)) for model in models)
    out = []
    for (weight, _), scale, residuals in zip(modes, scales, others, strict=True):
        by_frame = scale * parameter_shifts(found, residuals - base, np.asarray(seen.frames))
        out.append(np.sqrt(weight * np.maximum(np.square(by_frame.sum(0)), np.square(by_frame).sum(0))))
    return np.array(out)


def displaced(full: FullModel, body: trimesh.Trimesh, by: Float[np.ndarray, " V"]) -> FullModel:
    """The model on the twin's mesh, of a body whose surface is displaced along its normals [m]."""
    vertices, shift = np.asarray(body.vertices, dtype=np.float64), by[:, None] * np.asarray(body.vertex_normals)
    surface = full.surface
    if surface is not None:
        nearest = cKDTree(vertices).query(surface.points)[1]
        surface = SurfacePoints(surface.points + shift[nearest], surface.areas)
    mesh = filled(full.twin.mesh, vertices + shift, np.asarray(body.faces))
    return replace(full, mesh=mesh, surface=surface)
