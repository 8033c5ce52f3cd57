"""From a fit to estimates with intervals; the error that a finer model would remove."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from inference.refining.options import RefineOptions
from inference.refining.result import Estimate, interval_of
from inference.refining.stages import Stages
from physconvex.errors import ConvergenceError
from physconvex.fem import TetMesh, tetrahedralize
from physconvex.identify import (
    Fit,
    FullModel,
    Identifiability,
    Observations,
    Twin,
    noise_covariance,
    parameter_shift,
)

__all__ = ["estimates_of", "finer_mesh", "model_error"]

_FINER = 1.8  # nodes of the finer mesh over those of the twin


def estimates_of(found: Fit, shift: Float[np.ndarray, " K"], told: Identifiability) -> tuple[Estimate, ...]:
    """Each parameter with its deviations; `shift` is the model error [K], NaN where unknown."""
    inflation = max(found.reduced_chi_square, 1.0)
    sigmas = np.sqrt(np.diag(noise_covariance(found)) * inflation)
    out = []
    for i, parameter in enumerate(found.parameters):
        bound = parameter.name in told.at_bounds
        total = float(np.hypot(sigmas[i], np.nan_to_num(shift[i])))
        value = float(found.values[i])
        interval = None if bound else interval_of(value, total, parameter.lower, parameter.upper)
        prior = None
        if np.isfinite(parameter.prior_sigma):
            prior = (parameter.prior_mean, parameter.prior_sigma)
        out.append(
            Estimate(
                parameter.name, value, float(sigmas[i]), float(shift[i]), interval,
                parameter.lower, parameter.upper, prior,
            )
        )  # fmt: skip
    return tuple(out)


def finer_mesh(twin: Twin) -> TetMesh | None:
    """A finer quadratic mesh of the same surface, or None where none is found."""
    mesh = twin.mesh
    used, faces = np.unique(mesh.boundary_faces[:, :3], return_inverse=True)
    surface = twin.capture.mesh()
    pair = (mesh.vertices[used], faces.reshape(-1, 3))
    if surface is not None:
        pair = (np.asarray(surface.vertices, dtype=np.float64), np.asarray(surface.faces))
    try:
        return tetrahedralize(pair, max_nodes=int(_FINER * len(mesh.vertices)), order=2, method="auto")
    except ConvergenceError:
        return None


def model_error(
    twin: Twin, found: Fit, seen: Observations, options: RefineOptions, stages: Stages, warnings: list[str]
) -> Float[np.ndarray, " K"]:
    """How far a finer full model moves each value, to first order; NaN where that is not tried.

    With the correction the comparison is between the full model and one with a finer mesh and half the step; without
    it, between the reduced model and the full one.
    """
    if not options.model_error:
        return np.full(len(found.values), np.nan)
    frames = int(seen.frames.max()) + 1

    def compute() -> dict[str, np.ndarray]:
        exact = FullModel(twin, found.names, seen.points, frames)
        if not options.correction:
            change = seen.residuals(exact.positions(found.values)) - found.residuals
            return {"shift": parameter_shift(found, change), "meshed": np.array(1)}
        mesh = finer_mesh(twin)
        fine = FullModel(twin, found.names, seen.points, frames, mesh, refinement=2)
        change = seen.residuals(fine.positions(found.values)) - seen.residuals(exact.positions(found.values))
        return {"shift": parameter_shift(found, change), "meshed": np.array(int(mesh is not None))}

    try:
        arrays = stages.run("model_error", compute)
    except ConvergenceError as error:
        warnings.append(f"The model error is unknown: the finer model failed ({error}).")
        return np.full(len(found.values), np.nan)
    if not arrays["meshed"]:
        warnings.append("No finer mesh was found: the model error is that of the time step alone.")
    return np.asarray(arrays["shift"])
