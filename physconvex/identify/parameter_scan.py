"""A coarse scan over Young's modulus and Poisson's ratio: the subsequent search converges within half a decade."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.identify.levenberg_marquardt import FitOptions, fit
from physconvex.identify.observations import Observations, misfit_of
from physconvex.identify.parameters import Parameter
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
    starts = [tuple(_moved(p, {_MODULUS: m, _RATIO: r}) for p in parameters) for m, r in pairs]
    misfits = (workers or Workers()).map(partial(_misfit, model, observations), starts)
    found = [
        Candidate(*pair, misfit, start)
        for pair, start, misfit in zip(pairs, starts, misfits, strict=True)
        if misfit is not None
    ]
    if not found:
        raise ConvergenceError(f"scan: the model fails at all of log10 E = {[round(m, 2) for m in moduli]}")
    return sorted(found, key=lambda candidate: candidate.misfit)


def _misfit(model: PointModel, observations: Observations, start: tuple[Parameter, ...]) -> float | None:
    """Misfit of the model there; None if the body is too soft to be simulated."""
    try:
        return misfit_of(observations, model.positions(np.array([p.start for p in start])))
    except ConvergenceError:
        return None


def _rigid_fitted(
    model: PointModel, observations: Observations, parameters: Sequence[Parameter], modulus: float, ratio: float
) -> tuple[Parameter, ...]:
    """The parameters, with those that shift or turn the body improved by a few steps."""
    if not any(p.name.startswith("initial_") for p in parameters):
        return tuple(parameters)
    held = [_held(p, {_MODULUS: modulus, _RATIO: ratio}) for p in parameters]
    try:
        state = fit(model, observations, held, options=FitOptions(max_iterations=3))
    except ConvergenceError:
        return tuple(parameters)
    pairs = zip(parameters, state.values, strict=True)
    return tuple(p.at(float(v)) if p.name.startswith("initial_") else p for p, v in pairs)


def _moved(parameter: Parameter, values: dict[str, float]) -> Parameter:
    return parameter.at(values[parameter.name]) if parameter.name in values else parameter


def _held(parameter: Parameter, values: dict[str, float]) -> Parameter:
    if parameter.name not in values:
        return parameter
    return parameter.at(values[parameter.name]).held()
