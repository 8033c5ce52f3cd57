"""From a capture to a `Refinement`: observe, scan, search, correct, compare with a finer model, roll out."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from inference.prediction import Prediction
from inference.reconstruction import FIELD
from inference.refinement.appearance import RestField, appearance_of
from inference.refinement.coarse_start import START_OPTIONS, coarse_start
from inference.refinement.colour_search import fit_colours
from inference.refinement.convex_stage import CONVEX, convex_fit
from inference.refinement.estimates import (
    FitWithError,
    against_priors,
    fitted_parameters,
    slope_by_ratio,
    with_model_error,
    with_ratio_error,
    with_reduction_error,
)
from inference.refinement.field_adaptation import with_split_convexes
from inference.refinement.fine_fit import fit_on_more_nodes
from inference.refinement.geometry_error import geometry_error
from inference.refinement.meshes import twin_mesh
from inference.refinement.motion import future_rms, refined_motion
from inference.refinement.observations import observe_capture, selected
from inference.refinement.options import RefineOptions
from inference.refinement.problem import Problem, material_of, moved_inside, started_from, values_of
from inference.refinement.reduced_search import HEIGHT, ReducedSearch, predicted, with_free_height, with_predicted_ratio
from inference.refinement.result import FittedParameter, Refinement, StageEstimate, row_of
from inference.refinement.rigid_drift import drift_of, drifted, followed_motion, with_drift
from inference.refinement.stages import Arrays, RefinementRun, Stages, arrays_of_correction, fit_of, key_of, runs_of
from inference.rest_geometry import RECONSTRUCTION, rest_geometry_of
from models import find_checkpoint
from physconvex import ConvergenceError, InputError
from physconvex.fem import SurfacePoints
from physconvex.identify import (
    FULL_OPTIONS,
    Fit,
    FullModel,
    Identifiability,
    MarginalObservations,
    Twin,
    TwinOptions,
    base_twin,
    correct,
    default_parameters,
    fit_full,
    identifiability,
    noise_covariance,
    roll_out_together,
    with_free_friction,
)
from physconvex.io import Capture, Workers, load_capture
from physconvex.mesh import TetMesh
from physconvex.numerics import device_named
from physconvex.reduced import parameter_values

_STEPS_PER_CROSSING, _RATES = 15.0, (192.0, 768.0)  # steps while a wave crosses the body; least and most per second
_NOT_FOLLOWED = 5.0  # standard deviations rms of one source, above which intervals are meaningless
_WHERE = ("processes", "device", "stop_after")  # settings of where and how far, which leave each stage the same
_FRICTION = (0.4, 0.3)  # prior, mean and standard deviation, of a floor whose friction is not stated
_OF_A_FLOOR = (HEIGHT, "friction", "contact_damping")


def refine(
    path: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    initial: Prediction | None = None,
    options: RefineOptions | None = None,
    on_stage: Callable[[str, bool], None] | None = None,
) -> Refinement:
    """Identify the material of one capture, and predict its motion beyond the observed frames.

    Args:
        path: capture folder (`capture.json`, see the docs) with marker tracks, videos, or both. Without a rest geometry
            it is reconstructed from the first frames of all cameras.
        out: folder for finished stages, from which a stopped refinement continues; None keeps nothing. Result files are
            written by `inference.write_refinement`.
        initial: a prediction as the start, instead of a scan.
        options: settings.
        on_stage: called at the start of each stage, with its name and whether it is read from disk.

    Raises:
        InputError: an input is missing or wrong, or the device cannot be used; the message names it and the remedy.
        ConvergenceError: the body cannot be simulated at any start.
    """
    options = RefineOptions.or_default(options)
    device_named(options.device)
    find_checkpoint(options.checkpoint)
    if options.field_file is not None and not Path(options.field_file).is_file():
        raise InputError(
            f"field_file: there is no file {options.field_file}; expected a field (PLY) of the body at rest"
        )
    if initial is not None:
        start = {"log10_youngs_modulus": math.log10(initial.youngs_modulus), "poisson_ratio": initial.poisson_ratio}
        options = options.replace(initial={**start, **options.initial})
    capture, folder = load_capture(Path(path)), None if out is None else Path(out)
    selected(capture, options)  # what is missing is told before the work begins
    _check_floor(capture, options)
    warnings: list[str] = []
    if capture.floor is not None and capture.floor.friction is None and not options.states("friction"):
        options = options.replace(free=(*options.free, "friction"), priors={"friction": _FRICTION, **options.priors})
        warnings.append(
            "The capture does not state the friction of its floor, so it is fitted, with the prior {:g} ± {:g}; state "
            "it in capture.json if you know it.".format(*_FRICTION)
        )
    capture, made = rest_geometry_of(
        capture, body=options.body, out=folder, options=options.reconstruction, on_stage=on_stage
    )
    warnings += [] if made is None else made.warnings
    settings = {name: value for name, value in options.to_json().items() if name not in _WHERE}
    if capture.body is not None:
        settings["body"] = capture.body.identifier_hash
    if made is not None and folder is not None and options.field and options.field_file is None:
        options = options.replace(field_file=str(folder / RECONSTRUCTION / FIELD))
    stages = Stages(folder, key_of(capture.folder, settings), on_stage)
    with Workers(options.processes) as workers:
        return _refined(RefinementRun(capture, options, stages, workers, warnings, made))


def _check_floor(capture: Capture, options: RefineOptions) -> None:
    """Raise `InputError` where values of a floor are free or held, and there is none."""
    for where, names in (("free", options.free), ("fixed", options.fixed)):
        for name in _OF_A_FLOOR if capture.floor is None else ():
            if name in names:
                raise InputError(
                    f"{where}: got {name!r}, but the capture has no floor; give it one in capture.json, or leave it out"
                )


def _refined(run: RefinementRun) -> Refinement:
    """All steps, one after the other."""
    options, problem, search = run.options, _problem(run), ReducedSearch(run)
    rest = RestField(run)
    reduced = start = search.start(problem)
    candidates = search.candidates(problem, reduced)
    rows = _network_row(run)
    starts = (*candidates, *(_values_of(row, reduced) for row in rows))
    pixels = convex_fit(run, _with_time_step(run, problem, reduced), reduced, starts, rest)
    if pixels is not None:
        told = with_reduction_error(run, pixels)
        if options.stop_after is not None:
            run.options = options.replace(correction=False)
            return _result(run, pixels.problem, told, reduced, rest, rows)
        rows.append(
            StageEstimate.of(
                CONVEX, _estimates(pixels.problem, told, identifiability(told.fit))[0], _fixed(run, problem)
            )
        )
        candidates = (values_of(reduced.parameters, pixels.found, pixels.found.values), *candidates)
    ratio_sigma = None
    if run.reconstruction is not None:
        problem, ratio_sigma = with_predicted_ratio(run, problem)
        problem = with_free_height(run, problem)
        start, candidates = moved_inside(problem.parameters, reduced, candidates)
    coarse: FullModel | None = None
    beside: TetMesh | None = None
    if options.own_derivatives:
        try:
            problem, start, coarse, beside = coarse_start(run, problem, start, candidates)
        except ConvergenceError:  # too few nodes to be simulated: the reduced model's fit is the start
            pass
    if problem.observed.follows_points:
        problem = _followed_again(run, problem, start, coarse)
        if not options.own_derivatives:
            start = search.fit("reduced_again", problem, started_from(problem.parameters, start))
    problem = _with_time_step(run, problem, start)
    other = None if coarse is None else _model_beside(run, problem, start, beside)
    problem = with_drift(run, problem, start, "drift")
    if other is not None:
        problem = _with_errors(run, problem, other, start)
    compares_colours = (
        options.colours and (options.own_derivatives or not options.correction) and problem.observed.follows_points
    )
    found, full_runs, converged = _corrected(run, problem, start, last=not compares_colours)
    on_twin = found
    problem, found, converged = _on_more_nodes(run, problem, found, converged, last=not compares_colours)
    if run.options.correction and not converged:
        count = len(full_runs["runs"] if problem.mesh is None else found.history)
        run.warnings.append(f"The correction did not settle in {count} runs of the full model; allow more.")
    if compares_colours:
        problem, found = fit_colours(run, problem, found)
    problem = with_drift(run, problem, found, "drift_last")
    full = problem.full(run.memory)
    told = with_model_error(run, full, found, problem.seen, on_twin=None if problem.mesh is None else on_twin)
    if ratio_sigma is not None:
        told = with_ratio_error(told, ratio_sigma, slope_by_ratio(run, full, told.fit, problem.seen))
    return _result(run, problem, told, reduced, rest, rows, full=full, full_runs=full_runs, converged=converged)


def _values_of(row: StageEstimate, found: Fit) -> np.ndarray:
    """The values of a fit, with E and ν of a row."""
    known = {"log10_youngs_modulus": row.log10_youngs_modulus, "poisson_ratio": row.poisson_ratio}
    values = zip(found.parameters, found.values.tolist(), strict=True)
    return np.array([p.at(known.get(p.name, value)).start for p, value in values])


def _network_row(run: RefinementRun) -> list[StageEstimate]:
    """The network's answer, if the search has asked for it."""
    return [predicted(run)] if run.stages.known("network") else []


def _estimates(
    problem: Problem, told: FitWithError, known: Identifiability, by_geometry: np.ndarray | None = None
) -> tuple[tuple[FittedParameter, ...], dict[str, float], tuple[str, ...]]:
    """The parameters with their intervals, the residuals by source, and notes on sources that are not followed."""
    found, seen = told.fit, problem.observed.observations
    rms = problem.observed.rms(seen.residuals(drifted(problem, found)))
    notes = tuple(_not_followed(rms))
    estimates = fitted_parameters(
        found, told.left, known, problem.seen.frames, seen.residual_slices,
        by_geometry=by_geometry, stated=seen.stated, followed=not notes,
    )  # fmt: skip
    return estimates, rms, notes


def _result(
    run: RefinementRun,
    problem: Problem,
    told: FitWithError,
    reduced: Fit,
    rest: RestField,
    rows: Sequence[StageEstimate],
    *,
    full: FullModel | None = None,
    full_runs: Arrays | None = None,
    converged: bool | None = None,
) -> Refinement:
    """The refinement at a fit."""
    found, full = told.fit, full or problem.full(run.memory)
    motion = refined_motion(run, full, found, mesh=told.mesh)
    appearance = appearance_of(motion, rest)
    if appearance is not None and run.options.stop_after is None:  # an early answer is to be quick
        appearance = with_split_convexes(appearance, run.capture)
    by_geometry = geometry_error(run, full, found, problem.seen)
    known = identifiability(found)
    estimates, rms, notes = _estimates(problem, told, known, by_geometry)
    drift, fixed = drift_of(problem, found), _fixed(run, problem)
    run.warnings += [*notes, *against_priors(estimates), *(() if drift is None else drift.sentences())]
    last = StageEstimate.of("corrected" if run.options.correction else "reduced", estimates, fixed)
    if run.options.stop_after is not None:
        last = replace(last, name=CONVEX)
    return Refinement(
        path=str(run.capture.folder),
        estimates=estimates,
        fixed=fixed,
        covariance=noise_covariance(found),
        reduced_chi_square=found.reduced_chi_square,
        residual_rms=rms,
        nuisances=_nuisances(problem, found),
        drift=drift,
        followed=followed_motion(run, problem, full, found, motion),
        appearance=appearance,
        frame_errors=told.frame_errors,
        future_rms=future_rms(run.capture, motion),
        identifiability=known,
        history=found.history,
        reduced_values=values_of(found.parameters, reduced, reduced.values),
        full_runs=runs_of(full_runs or {}),
        converged=found.converged if converged is None else converged,
        motion=motion,
        observed_frames=run.capture.observed_frames,
        sources=problem.observed.sources,
        warnings=tuple(dict.fromkeys(run.warnings)),
        reconstruction=None if run.reconstruction is None else row_of(run.reconstruction),
        stages=(*rows, last),
    )


def _problem(run: RefinementRun) -> Problem:
    """The problem of the fit: the twin with the fixed values, the unknowns, the observations."""
    options = run.options
    sizes = TwinOptions(options.weights, options.max_nodes, options.steps_per_frame, fill=options.fill)
    twin = base_twin(run.capture, sizes, mesh=twin_mesh(run))
    if "friction" in options.free:
        twin = with_free_friction(twin)
    observed, twin = observe_capture(run, twin)
    run.warnings.extend(observed.notes)
    if options.held:
        twin = twin.with_values(list(options.held), np.array(list(options.held.values())))
    parameters = default_parameters(
        twin, damping="damping_time" not in options.fixed, free=options.free, fixed=list(options.fixed),
        priors=options.priors,
    )  # fmt: skip
    unknown = [name for name in options.initial if name not in [p.name for p in parameters]]
    if unknown:
        raise InputError(f"initial: {unknown} are not free; free are {[p.name for p in parameters]}")
    started = tuple(p.at(options.initial.get(p.name, p.start)) for p in parameters)
    return Problem(twin, started, observed, options.nuisance, _contact_surface(twin))


def _contact_surface(twin: Twin) -> SurfacePoints | None:
    """Points at which obstacles act: on the surface that the capture states, not on the nodes of a mesh."""
    if not twin.scene.obstacles:
        return None
    tets = None if twin.capture.mesh() is not None else twin.capture.tets()
    return SurfacePoints.of_triangles(*(twin.surface if tets is None else tets.surface))


def _followed_again(run: RefinementRun, problem: Problem, start: Fit, coarse: FullModel | None) -> Problem:
    """The problem with points followed again from their positions in the fitted model."""

    def move(points: np.ndarray) -> np.ndarray:
        return replace(coarse or problem.reduced, points=points).positions(start.values)

    return replace(problem, observed=problem.observed.followed_again(run, problem.twin, move))


def _with_time_step(run: RefinementRun, problem: Problem, start: Fit) -> Problem:
    """The problem with time steps that suit the body's elastic waves, unless the user gives their number.

    After an impact a body rings with periods of about twice its size over the speed of its waves.
    """
    twin = problem.twin
    if run.options.steps_per_frame is not None or not twin.may_strike:
        return problem
    modulus, density = material_of(twin, start)
    speed = float(np.sqrt(10.0**modulus / density))
    rate = float(np.clip(_STEPS_PER_CROSSING * speed / twin.mesh.size, *_RATES))
    return replace(problem, twin=replace(twin, steps_per_frame=max(4, math.ceil(rate / twin.fps))))


def _model_beside(run: RefinementRun, problem: Problem, start: Fit, mesh: TetMesh | None) -> FullModel:
    """The full model on another mesh, for comparison; the roll-outs needed on both run ahead, in parallel."""
    full = problem.full(run.memory)
    other = full if mesh is None else replace(full, mesh=mesh)
    if full.differenced and not run.stages.known("frame_errors"):  # the search starts with these derivatives
        roll_out_together([(other, start.values)], beside=[(full, start.values)])
    return other


def _with_errors(run: RefinementRun, problem: Problem, other: FullModel, start: Fit) -> Problem:
    """The problem with the difference to more nodes by frame: after an impact, bodies of few nodes soon go astray."""

    def compute() -> Arrays:
        here, there = problem.full(run.memory).begun(start.values), other.positions(start.values)
        return {"errors": problem.errors_between(here, there)}

    try:
        return replace(problem, errors=run.stages.run("frame_errors", compute)["errors"])
    except ConvergenceError:  # the correction reports it
        return problem


def _corrected(run: RefinementRun, problem: Problem, start: Fit, *, last: bool) -> tuple[Fit, Arrays, bool]:
    """The fit by the full model, its runs, and whether it has settled."""
    options = run.options
    if not options.correction:
        return start, {}, start.converged

    def compute() -> Arrays:
        full, most = problem.full(run.memory), options.full_runs
        if not options.own_derivatives:
            return arrays_of_correction(correct(problem.reduced, full, problem.seen, start, max_runs=most))
        settings, look_around = FULL_OPTIONS if last else START_OPTIONS, problem.drift_limit is None
        return arrays_of_correction(
            fit_full(full, problem.weighted, start, max_runs=most, options=settings, look_around=look_around)
        )

    try:
        arrays = run.stages.run("correction", compute)
    except ConvergenceError as error:
        run.options = options.replace(correction=False)
        run.warnings.append(
            f"The full model could not be run ({error}): the result is the reduced model's, which is too stiff."
        )
        return start, {}, start.converged
    found = fit_of(arrays, problem.parameters)
    return found, arrays, bool(arrays["correction_converged"]) and found.converged


def _on_more_nodes(
    run: RefinementRun, problem: Problem, found: Fit, converged: bool, *, last: bool
) -> tuple[Problem, Fit, bool]:
    """The problem on a mesh of more nodes, if there is one, its fit, and whether that has converged."""
    try:
        fine, again = fit_on_more_nodes(run, problem, found, last=last)
    except ConvergenceError as error:
        run.warnings.append(f"A mesh of more nodes could not be fitted ({error}): the result is of the twin's.")
        return problem, found, converged
    return fine, again, converged if fine is problem else again.converged


def _fixed(run: RefinementRun, problem: Problem) -> dict[str, float]:
    """The values of the fixed parameters."""
    held = dict.fromkeys(["log10_youngs_modulus", "poisson_ratio", *run.options.fixed])
    names = [name for name in held if name not in problem.names]
    values = parameter_values(problem.twin.scene, names) if names else np.zeros(0)
    return dict(zip(names, map(float, values), strict=True))


def _not_followed(rms: dict[str, float]) -> list[str]:
    return [
        f"The model does not follow {source}: {value:.0f} standard deviations rms. Its mesh, the floor, the camera or "
        "the law may be wrong; look at side_by_side.mp4. No interval is given."
        for source, value in rms.items()
        if value > _NOT_FOLLOWED
    ]


def _nuisances(problem: Problem, found: Fit) -> dict[str, float]:
    seen = problem.undrifted
    return seen.estimates(drifted(problem, found)) if isinstance(seen, MarginalObservations) else {}
