"""What a finer mesh and a shorter step say: their differences are added, and the error that is left is estimated.

    x(p) ≈ x_coarse(p) + [x_fine(p₀) − x_coarse(p₀)] + 4/3 [x_half(p₀) − x_coarse(p₀)],

fitted from p₀ and once more from where that ends. The time step is extrapolated (BDF2 is of second order); the mesh is
not, since corners of a clamp and contact spoil its order. What is left is taken as half of the mesh's difference and a
third of the step's. Its effect on a parameter is Σ_t g_t with g_t the first-order shift by frame t; as the error of
one frame says little of the next one's after an impact, √Σ g_t² is taken where it is larger.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from physconvex.fem import TetMesh
from physconvex.identify.correction import CorrectedModel, parameter_shifts
from physconvex.identify.full_fit import FULL_OPTIONS
from physconvex.identify.levenberg_marquardt import Fit, fit
from physconvex.identify.model import FullModel, Model
from physconvex.identify.observations import Observations
from physconvex.identify.uncertainty import noise_covariance
from physconvex.identify.weighting import WeightedObservations, frame_errors

__all__ = ["FinerFit", "fit_finer"]

_EXTRAPOLATED = 4.0 / 3.0
_MESH_LEFT, _STEP_LEFT = 0.5, 1.0 / 3.0
_SETTLED = 0.3  # of a standard deviation


@dataclass(frozen=True, eq=False)
class FinerFit:
    """A fit with the differences added.

    Attributes:
        fit: of the cheap model, shifted.
        left: standard deviation of each value by the error that is left, shape [K].
        frame_errors: e_t, the error that is left by frame, in standard deviations of the noise, shape [T].
    """

    fit: Fit
    left: Float[np.ndarray, " K"]
    frame_errors: Float[np.ndarray, " T"]


def fit_finer(
    cheap: Model,
    coarse: FullModel,
    mesh: TetMesh | None,
    observations: Observations,
    found: Fit,
    *,
    turns: int = 2,
) -> FinerFit:
    """Fit again with what a finer mesh and half the time step change.

    Args:
        cheap: gives the derivatives: the full model itself, or the reduced one.
        coarse: the full model.
        mesh: the finer mesh; None: the time step alone.
        observations: what was seen.
        found: the fit of the full model.
        turns: how often the differences are taken at most.

    Raises:
        ConvergenceError: a finer model fails.
    """
    values, last = found.values, found
    shape = (*found.positions.shape[:1], len(found.values), *found.positions.shape[1:])
    for _ in range(turns):
        x = coarse.positions(values)
        by_mesh = np.zeros_like(x) if mesh is None else replace(coarse, mesh=mesh).positions(values) - x
        by_step = replace(coarse, refinement=2 * coarse.refinement).positions(values) - x
        errors = np.hypot(
            _MESH_LEFT * frame_errors(observations, x + by_mesh, x),
            _STEP_LEFT * frame_errors(observations, x + by_step, x),
        )
        weighted = WeightedObservations.by_errors(observations, errors)
        shift = x + by_mesh + _EXTRAPOLATED * by_step - cheap.positions(values)
        start = [p.at(float(v)) for p, v in zip(found.parameters, values, strict=True)]
        model = CorrectedModel(cheap, values, shift, np.zeros(shape))
        last = fit(model, weighted, start, options=FULL_OPTIONS)
        left = np.hypot(
            _MESH_LEFT * _effect(last, weighted, x, by_mesh), _STEP_LEFT * _effect(last, weighted, x, by_step)
        )
        moved, values = np.abs(last.values - values), last.values
        if (moved <= _SETTLED * np.sqrt(np.diag(noise_covariance(last)))).all():
            break
    return FinerFit(last, left, errors)


def _effect(found: Fit, seen: WeightedObservations, x: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """How far a difference of the positions [m] moves each value: |Σ_t g_t|, or √Σ g_t² if that is more."""
    change = seen.residuals(x + difference) - seen.residuals(x)
    by_frame = parameter_shifts(found, change, np.asarray(seen.frames))
    return np.maximum(np.abs(by_frame.sum(0)), np.sqrt(np.square(by_frame).sum(0)))
