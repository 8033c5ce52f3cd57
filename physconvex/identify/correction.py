"""Corrects the reduced model's error: residuals from the full-order model, derivatives from the reduced one.

Space mapping (Bandler et al. 2004; Echeverría & Hemker 2005, "manifold mapping"): the full model is run at θ_k. The
difference of the two models shifts the reduced one,

    x(θ) = x_reduced(θ) + δ_k + D_k (θ − θ_k),        δ_k = x_full(θ_k) − x_reduced(θ_k).

The shifted model is fitted. D_k starts at zero and follows from the observed differences (Broyden's update). If the
first full run is far off (a body that swings out of phase), the shift does not help. Then the parameters are aligned
first (aggressive space mapping, Bandler et al. 1995): the reduced model is fitted to the full run, which gives θ̃, and
θ_1 = θ_0 + (θ_0 − θ̃).

The alternative is Levenberg–Marquardt on the full model with its own derivatives (`FullModel.linearise`), from the
reduced model's fit. If that is far off, a few nearby moduli are tried first: reduced models are too stiff, so that the
full model usually needs a larger E.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from physconvex.errors import ConvergenceError
from physconvex.identify.levenberg_marquardt import Fit, FitOptions, fit
from physconvex.identify.model import FullModel
from physconvex.identify.observations import MarkerObservations, Observations, misfit_of
from physconvex.identify.parameter_scan import with_best_modulus
from physconvex.identify.parameters import Parameter, lower_bounds, starts, step_scales, upper_bounds
from physconvex.identify.point_models import CorrectedModel, PointModel
from physconvex.identify.uncertainty import noise_covariance
from physconvex.numerics import broyden_update

_STEP_DONE = 0.01  # of a typical step: 0.002 decades of E
_NOISE_DONE = 0.2  # of a standard deviation
_INNER = FitOptions(max_iterations=8)
# a fifth of a standard deviation remains
FULL_OPTIONS: FitOptions = FitOptions(max_iterations=6, max_step=1.5, absolute_tolerance=0.02)
_TRIED = (0.1, 0.2, 0.35, -0.1)  # decades of E about the start
_FAR = 3.0  # times the reduced model's misfit
_ALIGNED = (0.0, 0.12, -0.12, -0.24, -0.36)  # decades of E; reduced models are too stiff, so that they need a smaller E


@dataclass(frozen=True, eq=False)
class FullRun:
    """One run of the full model: values [K], misfit of its prediction, rms distance to the preceding fit [m]."""

    values: Float[np.ndarray, " K"]
    misfit: float
    distance: float


@dataclass(frozen=True, eq=False)
class Correction:
    """The result.

    Attributes:
        fit: of the corrected model.
        model: the corrected model, exact at the last run of the full model, or the full model itself.
        runs: runs of the full model.
        converged: whether the last step is below a hundredth of the typical steps, or a fifth of the noise.
    """

    fit: Fit
    model: PointModel
    runs: tuple[FullRun, ...]
    converged: bool


def correct(
    model: PointModel, full: PointModel, observations: Observations, start: Fit, *, max_runs: int = 4
) -> Correction:
    """Fit again, with the difference to the full model included.

    If a step increases the full model's misfit, the next one starts from the best values and is half as long.

    Args:
        model: has derivatives; `start` is its fit.
        full: the more accurate model, with the same names and points.
        observations: the observations.
        start: the fit of `model`.
        max_runs: most runs of the full model.

    Raises:
        ConvergenceError: the full model fails at the start.
    """
    scales, prior = step_scales(start.parameters), _prior(start)
    frames, points, _ = start.positions.shape
    values, slope, current = start.values, np.zeros((frames, len(start.values), points, 3)), start
    runs: list[FullRun] = []
    best: tuple[float, CorrectedModel, Fit] | None = None
    previous: tuple[np.ndarray, np.ndarray] | None = None
    converged = False
    while len(runs) < max_runs:
        try:
            exact = full.positions(values)
        except ConvergenceError:
            if best is None:
                raise
            values = 0.5 * (values + best[1].anchor)
            runs.append(FullRun(values, float("inf"), float("nan")))
            continue
        shift = exact - model.positions(values)
        if previous is not None:
            slope = broyden_update(slope, values - previous[0], shift - previous[1], scales)
        previous = (values, shift)
        misfit = misfit_of(observations, exact) + prior(values)
        runs.append(FullRun(values, misfit, float(np.sqrt(np.square(shift).sum(-1).mean()))))
        if len(runs) == 1 and misfit > _FAR * start.misfit and max_runs > 1:
            values = _aligned(model, observations.points, exact, start)
            continue
        corrected = CorrectedModel(model, values, shift, slope)
        if best is not None and misfit > best[0] * (1 + 1e-6):
            values = 0.5 * (values + best[1].anchor)
            if converged := _small(values - best[1].anchor, best[2], scales):
                break
            continue
        nearby = [p.at(float(v)) for p, v in zip(start.parameters, values, strict=True)]
        current = fit(corrected, observations, nearby, options=replace(_INNER, max_step=1.5))
        best = (misfit, corrected, current)
        step, values = current.values - values, current.values
        if converged := _small(step, current, scales):
            break
    assert best is not None
    return Correction(best[2], best[1], tuple(runs), converged)


def _aligned(model: PointModel, points: np.ndarray, exact: np.ndarray, start: Fit) -> np.ndarray:
    """θ_0 + (θ_0 − θ̃), with θ̃ the reduced model's fit to the full run at θ_0."""
    sigma = 1e-3 * float(np.ptp(exact, axis=(0, 1)).max())
    seen = MarkerObservations(points, exact, np.full(exact.shape[:2], sigma))
    parameters = [
        replace(p, prior_sigma=float("inf")).at(float(v)) for p, v in zip(start.parameters, start.values, strict=True)
    ]
    nearest = with_best_modulus(model, seen, parameters, _ALIGNED)
    found = fit(model, seen, nearest, options=_INNER)
    lower, upper = lower_bounds(parameters), upper_bounds(parameters)
    return np.clip(2 * start.values - found.values, lower, upper)


def _small(step: np.ndarray, found: Fit, scales: np.ndarray) -> bool:
    limits = np.maximum(_STEP_DONE * scales, _NOISE_DONE * np.sqrt(np.diag(noise_covariance(found))))
    return bool((np.abs(step) < limits).all())


def _prior(start: Fit) -> Callable[[np.ndarray], float]:
    mean = np.array([p.prior_mean for p in start.parameters])
    precision = np.array([1 / p.prior_sigma for p in start.parameters])
    return lambda values: 0.5 * float(np.square((values - mean) * precision).sum())


def fit_full(
    full: PointModel,
    observations: Observations,
    start: Fit,
    *,
    max_runs: int = 8,
    options: FitOptions | None = None,
    look_around: bool = True,
) -> Correction:
    """Fit the full model, with its own derivatives.

    Args:
        full: has the names and points of the model that `start` fits.
        observations: the observations.
        start: the fit of the reduced model.
        max_runs: most states of the full model that are tried.
        options: further stopping rules.
        look_around: try a few moduli first if the full model's misfit is far above that of `start`.

    Raises:
        ConvergenceError: the full model fails at the start and at the nearby moduli.
    """
    parameters = tuple(p.at(float(v)) for p, v in zip(start.parameters, start.values, strict=True))
    first = _positions_at(full, parameters)
    misfit = np.inf if first is None else misfit_of(observations, first)
    if look_around and misfit > _FAR * start.misfit:
        parameters = with_best_modulus(full, observations, parameters, _TRIED, below=misfit)
    settings = replace(options or FULL_OPTIONS, max_iterations=max_runs)
    found = fit(full, observations, parameters, options=settings)
    distance = float("nan") if first is None else float(np.sqrt(np.square(first - start.positions).sum(-1).mean()))
    runs = [FullRun(state.values, state.misfit, float("nan")) for state in found.history]
    runs[0] = replace(runs[0], distance=distance)
    return Correction(found, full, tuple(runs), found.converged)


def _positions_at(full: PointModel, parameters: tuple[Parameter, ...]) -> np.ndarray | None:
    """Positions at a start (None if the model fails), with their derivatives, which the search needs next, if cheap."""
    values = starts(parameters)
    try:
        return full.begun(values) if isinstance(full, FullModel) else full.linearise(values)[0]
    except ConvergenceError:
        return None


def parameter_shift(found: Fit, change: Sequence[float] | np.ndarray) -> Float[np.ndarray, " K"]:
    """How far a change of the whitened residuals [N] moves the fitted values, to first order."""
    return parameter_shifts(found, change, np.zeros(len(change), dtype=int))[0]


def parameter_shifts(
    found: Fit, change: Sequence[float] | np.ndarray, groups: Int[np.ndarray, " N"]
) -> Float[np.ndarray, "G K"]:
    """How far each group of a change's rows moves the fitted values, to first order; groups count from 0."""
    rows = found.jacobian * (found.weights * np.asarray(change))[:, None]
    gradient = np.zeros((int(groups.max()) + 1, rows.shape[1]))
    np.add.at(gradient, groups, rows)
    return -gradient @ noise_covariance(found)
