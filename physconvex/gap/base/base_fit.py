"""Fits of the base model: a rough one by the reduced model, and one by the full-order model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError
from physconvex.gap.base.baseline import Baseline, Report
from physconvex.gap.base.body_modes import temperature
from physconvex.gap.base.model import RATIO, reduced_like
from physconvex.gap.base.rough_fit import run_again
from physconvex.gap.effects.motion import MotionCorrection, PointMotion
from physconvex.gap.options import GapOptions
from physconvex.gap.thresholds import BASE_FIT
from physconvex.identify import FitOptions, fit
from physconvex.mesh import TetMesh


def fit_baseline(
    rough: Baseline,
    correction: MotionCorrection,
    fine: tuple[TetMesh, PointMotion] | None,
    variance: Float[np.ndarray, " N"],
    *,
    options: GapOptions,
    report: Report,
) -> Baseline:
    """Fit the full-order base model, corrected by the change that a finer model makes, to the fitted frames.

    The reduced model searches, and the full-order model runs at the result, see `physconvex.gap.search.full_order`. If
    ν of a free body ends near either of its limits, a second fit starts from a middling ν, and the better of the two
    counts. A missing effect may open a false valley at such a ν, from which no dose is found.

    Args:
        rough: start of the fit.
        correction: see `EffectModel`.
        fine: a finer mesh for the full-order model, and its motion at the rough fit.
        variance: variance of the residuals in units of the stated noise, all frames; unpredictable frames count less.
        options, report: settings, and what receives progress messages.
    """
    first = _fit_from(rough, correction, fine, variance, options=options, report=report)
    names = first.model.base
    if rough.situation.clamped or RATIO not in names or first.model.cost.over:
        return first
    at = names.index(RATIO)
    if BASE_FIT.usual_poisson_ratio[0] <= first.fit.values[at] <= BASE_FIT.usual_poisson_ratio[1]:
        return first
    values = rough.fit.values.copy()
    values[at] = float(np.mean(BASE_FIT.usual_poisson_ratio))
    try:
        start = run_again(rough, replace(rough.fit, values=values))
        if fine is not None:
            fine = (fine[0], replace(start.model, mesh=fine[0]).motion(values))
        other = _fit_from(start, correction, fine, variance, options=options, report=report)
    except ConvergenceError:
        return first
    return min((first, other), key=lambda base: misfit_of_base(base, variance))


def _fit_from(
    rough: Baseline,
    correction: MotionCorrection,
    fine: tuple[TetMesh, PointMotion] | None,
    variance: Float[np.ndarray, " N"],
    *,
    options: GapOptions,
    report: Report,
) -> Baseline:
    """Fit from one start."""
    count = rough.split.end
    weighted = rough.weighted(variance, count)
    stop = FitOptions(max_iterations=options.iterations + 3, relative_tolerance=1e-3, absolute_tolerance=0.05)
    mesh, motion = (None, rough.motion) if fine is None else fine
    here = replace(rough, model=replace(rough.model, correction=correction, mesh=mesh), motion=motion)
    scales = np.array([p.step for p in here.model.parameters(here.fit.values)])
    best, least = here, misfit_of_base(here, variance)
    for number in range(BASE_FIT.rounds):
        report(f"fit of the full-order base model, round {number + 1}")
        model, motion = reduced_like(here.model, here.motion, here.fit.values)
        tangents = model.linearise(here.fit.values, motion)[1]
        here = replace(here, tangents=tangents)
        best = here if best.motion is here.motion else best
        shorter = replace(model, frames=count, doubt=_doubt(here, variance))
        secant = shorter.secant(here.fit.values, here.positions[:count], tangents[:count])
        found = fit(secant, weighted, shorter.parameters(here.fit.values), options=stop)
        if np.abs((found.values - here.fit.values) / scales).max() < BASE_FIT.still:
            return replace(here, fit=found) if here is best else best
        here = run_again(rough, found, mesh=mesh)
        stiffer = rough.model.surrogate_stiffer
        here = replace(here, model=replace(here.model, correction=correction, surrogate_stiffer=stiffer))
        misfit = misfit_of_base(here, variance)
        if misfit < least:
            best, least = here, misfit
        if here.model.cost.over:
            break
    if not best.tangents.any():
        model, motion = reduced_like(best.model, best.motion, best.fit.values)
        best = replace(best, tangents=model.linearise(best.fit.values, motion)[1])
    return best


def _doubt(base: Baseline, variance: Float[np.ndarray, " N"]) -> float:
    """Factor by which the stated noise overrates the fitted frames: lack of fit times correlation."""
    rows = base.rows(base.split.fitted)
    whitened = base.residual(base.positions)[rows] / np.sqrt(variance[rows])
    alike = temperature(whitened, base.observations.frames[rows], base.columns[rows])
    return max(float(np.mean(whitened**2)), 1.0) * alike


def misfit_of_base(
    base: Baseline, variance: Float[np.ndarray, " N"], positions: Float[np.ndarray, "T P 3"] | None = None
) -> float:
    """Mean square of the residuals of the fitted frames over their variance, of the base fit or of other positions."""
    rows = base.rows(base.split.fitted)
    return float(np.mean(base.residual(base.positions if positions is None else positions)[rows] ** 2 / variance[rows]))
