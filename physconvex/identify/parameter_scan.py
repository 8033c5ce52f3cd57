"""A coarse scan over Young's modulus and Poisson's ratio: the subsequent search converges within half a decade.

Also a few moduli near a start: a body that swings has one minimum of the misfit per period.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.identify.levenberg_marquardt import FitOptions, fit
from physconvex.identify.observations import Observations, model_misfit
from physconvex.identify.parameters import Parameter, starts
from physconvex.identify.point_models import PointModel
from physconvex.io import Workers

_MODULUS, _RATIO = "log10_youngs_modulus", "poisson_ratio"


@dataclass(frozen=True)
class Candidate:
    """A start and its misfit."""

    log10_youngs_modulus: float
    poisson_ratio: float
    misfit: float
    parameters: tuple[Parameter, ...]


def scan_values(*, density: float, gravity: float, size: float) -> tuple[float, ...]:
    """log10 E of a scan without prior knowledge: E/(ρ g L) from 0.5 to 2000, in half decades."""
    unit = np.log10(density * max(gravity, 1.0) * size)
    return tuple(float(unit + decades) for decades in np.arange(-0.3, 3.31, 0.45))


def scan(
    model: PointModel,
    observations: Observations,
    parameters: Sequence[Parameter],
    *,
    moduli: Sequence[float],
    ratios: Sequence[float] = (0.25, 0.45),
    workers: Workers | None = None,
) -> list[Candidate]:
    """Candidates for the start, best first.

    Unknowns that shift or turn the body are fitted once first, at the middle modulus. Then the model is evaluated at
    each pair (E, ν). Pairs at which it fails are left out.

    Args:
        model: a cheap model is accurate enough.
        observations: the observations.
        parameters: the unknowns, including log10 E; ν if it is free.
        moduli: log10 E.
        ratios: ν; only the present value if it is not free.
        workers: evaluate several pairs at once.

    Raises:
        ConvergenceError: the model cannot be evaluated at any pair.
    """
    free = any(p.name == _RATIO for p in parameters)
    parameters = _rigid_fitted(model, observations, parameters, moduli[len(moduli) // 2], ratios[0])
    pairs = [(modulus, ratio) for modulus in moduli for ratio in (ratios if free else (float("nan"),))]
    trials = [tuple(_moved(p, {_MODULUS: m, _RATIO: r}) for p in parameters) for m, r in pairs]
    misfits = (workers or Workers()).map(partial(_misfit, model, observations), trials)
    tried = [Candidate(*pair, misfit, trial) for pair, misfit, trial in zip(pairs, misfits, trials, strict=True)]
    found = [candidate for candidate in tried if candidate.misfit < np.inf]
    if not found:
        raise ConvergenceError(f"scan: the model fails at all of log10 E = {[round(m, 2) for m in moduli]}")
    return sorted(found, key=lambda candidate: candidate.misfit)


def _misfit(model: PointModel, observations: Observations, start: tuple[Parameter, ...]) -> float:
    return model_misfit(model, observations, starts(start))


def with_best_modulus(
    model: PointModel,
    observations: Observations,
    parameters: Sequence[Parameter],
    changes: Sequence[float],
    *,
    below: float = np.inf,
) -> tuple[Parameter, ...]:
    """The parameters with the log10 E of least misfit among a few nearby ones; unchanged if log10 E is not free.

    Args:
        model, observations: give the misfit.
        parameters: the unknowns of the model.
        changes: of log10 E [decades].
        below: misfit that a change must improve on.
    """
    best, chosen = below, tuple(parameters)
    for change in changes if _MODULUS in model.names else ():
        trial = tuple(p.at(p.start + change) if p.name == _MODULUS else p for p in parameters)
        misfit = _misfit(model, observations, trial)
        if misfit < best:
            best, chosen = misfit, trial
    return chosen


def _rigid_fitted(
    model: PointModel, observations: Observations, parameters: Sequence[Parameter], modulus: float, ratio: float
) -> tuple[Parameter, ...]:
    """The parameters, with those that shift or turn the body improved by a few steps."""
    if not any(p.name.startswith("initial_") for p in parameters):
        return tuple(parameters)
    values = {_MODULUS: modulus, _RATIO: ratio}
    held = [_moved(p, values).held() if p.name in values else p for p in parameters]
    try:
        state = fit(model, observations, held, options=FitOptions(max_iterations=3))
    except ConvergenceError:
        return tuple(parameters)
    pairs = zip(parameters, state.values, strict=True)
    return tuple(p.at(float(v)) if p.name.startswith("initial_") else p for p, v in pairs)


def _moved(parameter: Parameter, values: dict[str, float]) -> Parameter:
    return parameter.at(values[parameter.name]) if parameter.name in values else parameter
