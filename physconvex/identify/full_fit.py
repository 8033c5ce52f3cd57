"""Levenberg–Marquardt on the full-order model, started at the reduced model's fit.

Residuals and derivatives are the full model's (`FullModel.linearise`), so that the result is a minimum of the full
model. If the start is far off, a few nearby moduli are tried first. Reduced models are too stiff, so that the full
model usually needs a larger E.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.identify.correction import FAR, Correction, FullRun
from physconvex.identify.levenberg_marquardt import Fit, FitOptions, Iteration, fit
from physconvex.identify.model import FullModel
from physconvex.identify.observations import Observations, misfit_of
from physconvex.identify.parameters import Parameter
from physconvex.identify.point_models import PointModel

FULL_OPTIONS: FitOptions = FitOptions(
    max_iterations=6, max_step=1.5, absolute_tolerance=0.02
)  # a fifth of a standard deviation remains

_TRIED = (0.1, 0.2, 0.35, -0.1)  # decades of E about the start
_MODULUS = "log10_youngs_modulus"


def fit_full(
    full: PointModel,
    observations: Observations,
    start: Fit,
    *,
    max_runs: int = 8,
    options: FitOptions | None = None,
    look_around: bool = True,
    on_run: Callable[[Iteration], None] | None = None,
) -> Correction:
    """Fit the full model, with its own derivatives.

    Args:
        full: has the names and points of the model that `start` fits.
        observations: the observations.
        start: the fit of the reduced model.
        max_runs: most states of the full model that are tried.
        options: further stopping rules.
        look_around: try a few moduli first if the full model's misfit is far above that of `start`.
        on_run: called with each accepted state.

    Raises:
        ConvergenceError: the full model fails at the start and at the nearby moduli.
    """
    parameters = tuple(p.at(float(v)) for p, v in zip(start.parameters, start.values, strict=True))
    chosen, first = _start(full, observations, parameters, start, look_around=look_around)
    settings = replace(options or FULL_OPTIONS, max_iterations=max_runs)
    found = fit(full, observations, chosen, options=settings, on_iteration=on_run)
    distance = float("nan") if first is None else float(np.sqrt(np.square(first - start.positions).sum(-1).mean()))
    runs = [FullRun(state.values, state.misfit, float("nan")) for state in found.history]
    runs[0] = replace(runs[0], distance=distance)
    return Correction(found, full, tuple(runs), found.converged)


def _start(
    full: PointModel, observations: Observations, parameters: tuple[Parameter, ...], start: Fit, *, look_around: bool
) -> tuple[tuple[Parameter, ...], np.ndarray | None]:
    """The start, and the full model's positions at the reduced model's fit (None if it fails there)."""
    first = _first(full, parameters)
    best = np.inf if first is None else misfit_of(observations, first)
    if not look_around or best <= FAR * start.misfit or _MODULUS not in full.names:
        return parameters, first
    place, chosen = full.names.index(_MODULUS), parameters
    for change in _TRIED:
        trial = list(parameters)
        trial[place] = trial[place].at(trial[place].start + change)
        positions = _run(full, trial)
        if positions is not None and (misfit := misfit_of(observations, positions)) < best:
            best, chosen = misfit, tuple(trial)
    return chosen, first


def _first(full: PointModel, parameters: tuple[Parameter, ...]) -> np.ndarray | None:
    """The linearisation at a start, if derivatives come with the positions; the search needs it next."""
    values = np.array([p.start for p in parameters])
    try:
        return full.begun(values) if isinstance(full, FullModel) else full.linearise(values)[0]
    except ConvergenceError:
        return None


def _run(full: PointModel, parameters: tuple[Parameter, ...] | list[Parameter]) -> np.ndarray | None:
    try:
        return full.positions(np.array([p.start for p in parameters]))
    except ConvergenceError:
        return None
