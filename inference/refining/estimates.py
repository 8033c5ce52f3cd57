"""From a fit to estimates with intervals; the error that a finer model would remove."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from inference.refining.fits import arrays_of_fit, fit_of
from inference.refining.options import RefineOptions
from inference.refining.result import Estimate, interval_of
from inference.refining.stages import Stages
from physconvex.errors import ConvergenceError
from physconvex.fem import TetMesh, tetrahedralize
from physconvex.fem.mesh import refine as subdivided
from physconvex.identify import (
    CorrectedModel,
    Fit,
    FitOptions,
    FullModel,
    Identifiability,
    Observations,
    ReducedModel,
    Twin,
    WeightedObservations,
    fit,
    frame_errors,
    noise_covariance,
    parameter_shift,
)

__all__ = ["Judged", "estimates_of", "finer_mesh", "judge"]

_FINER = 1.8  # nodes of a mesh made anew over those of the twin
_MOST_NODES = 4000  # of tetrahedra cut in eight


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
    """A finer quadratic mesh of the same body, or None where none is found that is small enough.

    Tetrahedra of the capture are cut in eight each, which keeps the geometry; a mesh that was made from the capture's
    surface is made again with 1.8 times the nodes.
    """
    capture, mesh = twin.capture, twin.mesh
    surface = capture.mesh()
    tets = capture.tets()
    if tets is not None and np.array_equal(mesh.vertices[: len(tets.vertices)], tets.vertices):
        fine = subdivided(mesh)
        return fine if len(fine.vertices) <= _MOST_NODES else None
    if surface is None:
        return None
    pair = (np.asarray(surface.vertices, dtype=np.float64), np.asarray(surface.faces))
    try:
        return tetrahedralize(pair, max_nodes=int(_FINER * len(mesh.vertices)), order=2, method="auto")
    except ConvergenceError:
        return None


@dataclass(frozen=True, eq=False)
class Judged:
    """A fit judged by a finer model.

    Attributes:
        fit: the last one; with the correction on, of the reduced model shifted to the finer model.
        shift: how far the finer model moves each value, to first order, shape [K]; NaN where unknown.
        frame_errors: rms difference between the two models in each frame, in standard deviations of the noise, [T].
    """

    fit: Fit
    shift: Float[np.ndarray, " K"]
    frame_errors: Float[np.ndarray, " T"]


def judge(
    twin: Twin, found: Fit, seen: Observations, options: RefineOptions, stages: Stages, warnings: list[str]
) -> Judged:
    """Compare with a finer model, let frames count by what that changes, and fit once more.

    With the correction the comparison is between the full model and one with a finer mesh (half the step, where there
    is none), and the last fit takes its residuals from the latter; without it, between the reduced model and the full
    one, and nothing is fitted again.
    """
    frames = int(seen.frames.max()) + 1
    unknown = Judged(found, np.full(len(found.values), np.nan), np.zeros(frames))
    if not options.model_error:
        return unknown

    def compute() -> dict[str, np.ndarray]:
        exact = FullModel(twin, found.names, seen.points, frames).positions(found.values)
        if not options.correction:
            change = seen.residuals(exact) - found.residuals
            errors = frame_errors(seen, exact, found.positions)
            return {"shift": parameter_shift(found, change), "errors": errors, "meshed": np.array(1)}
        mesh = finer_mesh(twin)
        steps = 2 if mesh is None else 1
        fine = FullModel(twin, found.names, seen.points, frames, mesh, refinement=steps).positions(found.values)
        errors = frame_errors(seen, fine, exact)
        last = _fit_again(twin, found, WeightedObservations.by_errors(seen, errors), fine)
        change = WeightedObservations.by_errors(seen, errors)
        shift = parameter_shift(last, change.residuals(fine) - change.residuals(exact))
        return arrays_of_fit(last) | {"shift": shift, "errors": errors, "meshed": np.array(int(mesh is not None))}

    try:
        arrays = stages.run("model_error", compute)
    except ConvergenceError as error:
        warnings.append(f"The model error is unknown: the finer model failed ({error}).")
        return unknown
    if not arrays["meshed"]:
        warnings.append(
            "No finer mesh was tried (too many nodes, or none found): the model error is that of the time step alone."
        )
    last = fit_of(arrays, found.parameters) if "values" in arrays else found
    return Judged(last, arrays["shift"], arrays["errors"])


def _fit_again(twin: Twin, found: Fit, seen: Observations, fine: np.ndarray) -> Fit:
    """From the fitted values, with the reduced model shifted to the finer one."""
    reduced = ReducedModel(twin, found.names, seen.points, len(fine))
    shift = fine - reduced.positions(found.values)
    slope = np.zeros((len(fine), len(found.values), *fine.shape[1:]))
    start = [p.at(float(v)) for p, v in zip(found.parameters, found.values, strict=True)]
    corrected = CorrectedModel(reduced, found.values, shift, slope)
    return fit(corrected, seen, start, options=FitOptions(max_iterations=8, max_step=1.5))
