"""Estimates with intervals from a fit; the error that a finer model would remove."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from inference.refinement.convex_stage import ConvexFit
from inference.refinement.meshes import comparison_mesh, is_of_capture
from inference.refinement.problem import HELD
from inference.refinement.result import FittedParameter, interval_of, unit_of
from inference.refinement.stages import Arrays, RefinementRun, arrays_of_fit, fit_of
from physconvex import ConvergenceError
from physconvex.identify import (
    LEFT_BY_FITTED,
    Fit,
    FullModel,
    Identifiability,
    Observations,
    ReducedModel,
    clustered_deviations,
    default_parameter,
    fit_finer,
    frame_errors,
    marginal_deviations,
    parameter_shift,
)
from physconvex.mesh import TetMesh

# standard deviation by the choice of a mesh made of a surface, of bodies that hit something: error of E [decades]
# and ν in a first-order fit to motions of other meshes (benchmarks/twin_meshes.py)
_BY_MESH = {"log10_youngs_modulus": 0.012, "poisson_ratio": 0.03}
_RATIO = "poisson_ratio"
_AGAINST = 3.0  # standard deviations of its prior, from which on an estimate is told
# of twenty elastic weights: rms error of E on reconstructed bodies whose video the twin follows [decades]
# (docs/results/paper_images.md); largest bias of ν against the full model (benchmarks/reduced_accuracy.py)
_BY_REDUCTION = {"log10_youngs_modulus": 0.14, "poisson_ratio": 0.19}


def fitted_parameters(
    found: Fit,
    left: Float[np.ndarray, " K"],
    told: Identifiability,
    frames: Int[np.ndarray, " N"],
    sources: Sequence[slice],
    *,
    stated: Sequence[bool],
    by_geometry: Float[np.ndarray, " K"] | None = None,
    followed: bool = True,
) -> tuple[FittedParameter, ...]:
    """Each parameter with its standard deviations.

    Args:
        found: the fit.
        left: deviation by model error, NaN where unknown.
        told: how well the data determine the parameters, and those at a bound.
        frames: frame of each residual.
        sources: the residuals of each source; each is tested on its own, so that many good ones do not hide a bad one.
        stated: whether the recording states the noise of each source; the noise of images is the size of their
            residuals.
        by_geometry: deviation by the error of a reconstructed body, NaN where unknown; None with a given geometry.
        followed: whether the model fits the recording; if not, there are no intervals.
    """
    sigmas = marginal_deviations(found, _variances(found, sources, stated))
    sigmas = np.maximum(sigmas, clustered_deviations(found, frames))
    geometry = np.zeros(len(left)) if by_geometry is None else by_geometry
    total = np.sqrt(np.square(np.nan_to_num([sigmas, left, geometry])).sum(axis=0))
    out = []
    for k, p in enumerate(found.parameters):
        value, usual = float(found.values[k]), default_parameter(p.name)
        bounded = interval_of(value, float(total[k]), usual.lower, usual.upper)
        interval = bounded if followed and p.name not in told.at_bounds else None
        prior = (p.prior_mean, p.prior_sigma) if np.isfinite(p.prior_sigma) else None
        parts = (float(sigmas[k]), float(left[k]))
        out.append(
            FittedParameter(p.name, value, *parts, interval, usual.lower, usual.upper, prior, float(geometry[k]))
        )
    return tuple(out)


def against_priors(estimates: Sequence[FittedParameter]) -> list[str]:
    """A note on each value that lies far from its prior, but for those that a narrow one holds."""
    notes = []
    for one in estimates:
        mean, sigma = one.prior or (one.value, 1.0)
        if sigma <= HELD * default_parameter(one.name).step:
            continue
        if (away := abs(one.value - mean) / sigma) > _AGAINST:
            notes.append(
                f"{one.name} is {one.value:.3g} {unit_of(one.name)}, {away:.0f} standard deviations from its prior "
                f"({mean:.3g} ± {sigma:.2g}): the model takes it for something that it lacks, and so may the other "
                "values."
            )
    return notes


def _variances(found: Fit, sources: Sequence[slice], stated: Sequence[bool]) -> Float[np.ndarray, " N"]:
    """Variances of the residuals by source, at least one if stated; the worst one for all if it is above one."""
    squares = [float(np.mean(found.residuals[where] ** 2)) for where in sources]
    worst = max(found.reduced_chi_square, *squares)
    out = np.full(len(found.residuals), max(worst, 1.0))
    if worst <= 1.0:
        for where, square, known in zip(sources, squares, stated, strict=True):
            out[where] = 1.0 if known else square
    return out


@dataclass(frozen=True, eq=False)
class FitWithError:
    """A fit, and its comparison with a finer model.

    Attributes:
        fit: the last one; with the correction on, of the finer model.
        left: standard deviation of each value by the remaining model error, shape [K]; NaN where unknown.
        frame_errors: rms remaining model error in each frame, in standard deviations of the noise, [T].
        mesh: the finer mesh; None if there is none.
    """

    fit: Fit
    left: Float[np.ndarray, " K"]
    frame_errors: Float[np.ndarray, " T"]
    mesh: TetMesh | None = None


def with_model_error(
    run: RefinementRun, full: FullModel, found: Fit, seen: Observations, *, on_twin: Fit | None = None
) -> FitWithError:
    """Compare with a finer model, weight the frames by the difference, and fit once more.

    With the correction, the full model is compared with one on a finer mesh (or a coarser one, if it is on the finer
    mesh already) and with one of half the time step. The last fit extrapolates from these. Without the correction, the
    reduced model is compared with the full one, and there is no further fit.

    Args:
        run: the refinement.
        full: the fitted model.
        found: the fit.
        seen: the observations.
        on_twin: the fit on the twin's mesh, if `full` is on a finer one.
    """
    options, warnings = run.options, run.warnings
    twin, frames = full.twin, full.frames
    unknown = FitWithError(found, np.full(len(found.values), np.nan), np.zeros(frames), full.mesh)
    if not options.model_error:
        return unknown
    mesh = full.mesh
    if mesh is None and options.correction:
        mesh = comparison_mesh(run, twin)

    def compute() -> Arrays:
        own = replace(full, points=seen.points)
        coarse = replace(own, mesh=None)
        if not options.correction:
            exact = coarse.positions(found.values)
            change = seen.residuals(exact) - found.residuals
            errors = frame_errors(seen, exact, found.positions)
            return {"left": np.abs(parameter_shift(found, change)), "errors": errors}
        cheap = own if options.jacobian == "full" else ReducedModel(twin, found.names, seen.points, frames)
        finer = fit_finer(cheap, coarse, mesh, seen, found)
        kept = {"left": finer.left, "errors": finer.frame_errors, "runs_away": np.array(finer.runs_away)}
        return arrays_of_fit(finer.fit) | kept

    try:
        arrays = run.stages.run("model_error", compute)
    except ConvergenceError as error:
        warnings.append(f"The model error is unknown: the finer model failed ({error}).")
        return unknown
    if options.correction and mesh is None:
        warnings.append(
            "No finer mesh was tried (too many nodes, or none found): the model error is that of the time step alone."
        )
    last = fit_of(arrays, found.parameters) if "values" in arrays else found
    left = arrays["left"]
    runs_away = bool(arrays.get("runs_away", False))
    if on_twin is not None:
        left = np.hypot(left, LEFT_BY_FITTED * np.abs(found.values - on_twin.values))
    if twin.may_strike or runs_away:  # after an impact meshes do not converge: the whole difference counts
        left = np.hypot(left, np.abs(last.values - found.values))
    if twin.may_strike and not is_of_capture(twin):
        left = np.hypot(left, [_BY_MESH.get(p.name, 0.0) for p in found.parameters])
    if runs_away:
        last = found
        warnings.append(
            "A finer mesh, or half the time step, moves the estimates further at every turn: models of this body part "
            "ever further. The estimates are those of the coarser model; their intervals take in what the finer one "
            "moved."
        )
    return FitWithError(last, left, arrays["errors"], mesh)


def with_reduction_error(run: RefinementRun, pixels: ConvexFit) -> FitWithError:
    """The convex twin's fit, with the error that its few weights leave on average, or by the network's of its ν."""
    left = np.array([_BY_REDUCTION.get(p.name, np.nan) for p in pixels.found.parameters])
    told = FitWithError(pixels.found, left, np.zeros(run.capture.observed_frames))
    if pixels.ratio_sigma is None:
        return told
    return with_ratio_error(told, pixels.ratio_sigma, told.fit.jacobian[:, told.fit.names.index(_RATIO)])


def slope_by_ratio(run: RefinementRun, full: FullModel, found: Fit, seen: Observations) -> Float[np.ndarray, " N"]:
    """Derivatives of the residuals by ν, which the fit has held: a difference of two roll-outs if it left them out."""
    place = found.names.index(_RATIO)
    if not (run.options.own_derivatives and full.held and full.differenced):
        return found.jacobian[:, place]

    def compute() -> Arrays:
        own = replace(full, points=seen.points, held=())
        moved = own.beside(found.values)[place]
        here, there = (seen.residuals(own.positions(values)) for values in (found.values, moved))
        return {"slope": (there - here) / (moved - found.values)[place]}

    try:
        return run.stages.run("ratio", compute)["slope"]
    except ConvergenceError as error:
        run.warnings.append(f"What the error of Poisson's ratio does to the other values is unknown ({error}).")
        return np.zeros(len(found.residuals))


def with_ratio_error(told: FitWithError, sigma: float, slope: Float[np.ndarray, " N"]) -> FitWithError:
    """A fit in which ν is held, with the error of every value by that of ν.

    Args:
        told: the fit.
        sigma: standard deviation of ν [1].
        slope: derivatives of the residuals by ν.
    """
    found, place = told.fit, told.fit.names.index(_RATIO)
    rows = np.vstack(
        [np.sqrt(found.weights)[:, None] * found.jacobian, np.diag([1 / p.prior_sigma for p in found.parameters])]
    )
    others = [k for k in range(len(found.values)) if k != place]
    by_ratio = np.full(len(found.values), sigma)
    changes = np.concatenate([np.sqrt(found.weights) * slope, np.zeros(len(found.values))])
    by_ratio[others] *= np.abs(np.linalg.lstsq(rows[:, others], changes, rcond=None)[0])
    left = np.where(np.isnan(told.left), by_ratio, np.hypot(told.left, by_ratio))
    left[place] = sigma
    return replace(told, left=left)
