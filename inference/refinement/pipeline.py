"""From a capture to a `Refinement`: observe, scan, search, correct, judge, roll out."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from inference.prediction import Prediction
from inference.refinement.appearance import appearance_of, begun_field
from inference.refinement.coarse_start import START_OPTIONS, Beginning
from inference.refinement.colour_search import ColourSearch
from inference.refinement.estimates import estimates_of, judge
from inference.refinement.fine_fit import Refitting
from inference.refinement.fits import arrays_of_correction, fit_of, runs_of
from inference.refinement.meshes import finer_mesh
from inference.refinement.motion import future_rms, motion_of
from inference.refinement.observations import observe
from inference.refinement.options import RefineOptions
from inference.refinement.problem import Problem
from inference.refinement.reduced_search import ReducedSearch, material_of, started_from
from inference.refinement.result import Refinement
from inference.refinement.rigid_drift import drift_of, drifted, followed_motion, with_drift
from inference.refinement.stages import Stages, key_of
from physconvex import ConvergenceError, InputError
from physconvex.fem import SurfacePoints
from physconvex.identify import (
    FULL_OPTIONS,
    Fit,
    FullModel,
    MarginalObservations,
    Parameter,
    RollOuts,
    Twin,
    TwinOptions,
    base_twin,
    correct,
    default_parameters,
    fit_full,
    frame_errors,
    identifiability,
    noise_covariance,
    roll_out_together,
    with_free_friction,
)
from physconvex.io import Capture, Workers, load_capture
from physconvex.numerics import device_named
from physconvex.reduced import parameter_values

__all__ = ["refine"]

_STEPS_PER_CROSSING, _RATES = 15.0, (192.0, 768.0)  # steps while a wave crosses the body; least and most per second
_NOT_FOLLOWED = 5.0  # standard deviations rms of one source, from which no interval says anything
_WHERE = ("processes", "device")  # settings that say where it is computed, not what
_LEFT = 0.5  # of the difference between few and more nodes: what more nodes still err by
Arrays = dict[str, np.ndarray]
Start = tuple[Parameter, ...]


def refine(
    path: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    initial: Prediction | None = None,
    options: RefineOptions | None = None,
    on_stage: Callable[[str, bool], None] | None = None,
) -> Refinement:
    """Identify the material of one capture, and its motion beyond the observed frames.

    Args:
        path: capture folder (`capture.json`, see the docs) with a rest geometry and marker tracks, videos, or both.
        out: folder for finished stages, so that a stopped refinement goes on; None keeps nothing. Result files are
            written by `inference.refinement.write_refinement`.
        initial: a prediction to start at, in the place of a scan.
        options: settings.
        on_stage: told the name of each stage when it begins, and whether it was read again.

    Raises:
        InputError: something that is needed is missing or wrong, or the device cannot be used; the message names it
            and the remedy.
        ConvergenceError: no start was found at which the body can be simulated.
    """
    options = options or RefineOptions()
    device_named(options.device)
    if initial is not None:
        start = {"log10_youngs_modulus": math.log10(initial.youngs_modulus), "poisson_ratio": initial.poisson_ratio}
        options = options.replace(initial={**start, **options.initial})
    capture = load_capture(Path(path))
    stages = Stages(None if out is None else Path(out), _key(capture, options), on_stage)
    with Workers(options.processes) as workers:
        return _Run(capture, options, stages, workers).refine()


def _key(capture: Capture, options: RefineOptions) -> str:
    settings = {name: value for name, value in options.to_json().items() if name not in _WHERE}
    return key_of(capture.folder, settings)


class _Run:
    def __init__(self, capture: Capture, options: RefineOptions, stages: Stages, workers: Workers) -> None:
        self.capture, self.options, self.stages = capture, options, stages
        self.warnings: list[str] = []
        self.search = ReducedSearch(capture, options, stages, self.warnings, workers)
        self.start_model: FullModel | None = None  # what the points are followed again by
        self.workers, self.memory = workers, RollOuts(workers=workers)

    def refine(self) -> Refinement:
        problem = self._problem()
        reduced = start = self.search.run(problem)
        if self.options.own_derivatives:
            problem, start = self._begun(problem, reduced)
        if problem.observed.follows_points:
            problem, start = self._anchored(problem, start)
        problem = self._with_step(problem, start)
        other = self._beside(problem, start)
        problem = self._with_drift(problem, start, "drift")
        if other is not None:
            problem = self._with_errors(problem, other, start)
        coloured = (
            self.options.colours
            and (self.options.own_derivatives or not self.options.correction)
            and problem.observed.follows_points
        )
        final, runs, converged = self._corrected(problem, start, last=not coloured)
        before = final
        problem, final, converged = self._refitted(problem, final, converged, last=not coloured)
        if self.options.correction and not converged:
            count = len(runs["runs"] if problem.mesh is None else final.history)
            self.warnings.append(f"The correction did not settle in {count} runs of the full model; allow more.")
        if coloured:
            search = ColourSearch(self.capture, self.options, self.stages, self.memory, self.warnings, self._with_drift)
            problem, final = search.run(problem, final)
        problem = self._with_drift(problem, final, "drift_last")
        return self._result(problem, reduced, final, runs, converged, before=None if problem.mesh is None else before)

    # -- set-up

    def _problem(self) -> Problem:
        options = self.options
        sizes = TwinOptions(options.weights, options.max_nodes, options.steps_per_frame, fill=options.fill)
        twin = base_twin(self.capture, sizes)
        if "friction" in options.free:
            twin = with_free_friction(twin)
        observed, twin = observe(self.capture, twin, options, self.stages)
        self.warnings.extend(observed.notes)
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
        return Problem(twin, started, observed, options.nuisance, self._surface(twin))

    def _surface(self, twin: Twin) -> SurfacePoints | None:
        """Where obstacles act: on the surface that the capture states, not on the nodes of whatever mesh carries it."""
        if not twin.scene.obstacles:
            return None
        tets = None if self.capture.mesh() is not None else self.capture.tets()
        return SurfacePoints.of_triangles(*(twin.surface if tets is None else tets.surface))

    # -- stages

    def _begun(self, problem: Problem, reduced: Fit) -> tuple[Problem, Fit]:
        """The full model on few nodes, with long steps: a start without the reduced model's stiffness."""
        beginning = Beginning(self.capture, self.stages, self.memory, self.options.drift)
        try:
            candidates = self.search.candidates(problem, reduced)
            problem, start, self.start_model = beginning.find(problem, reduced, candidates)
        except ConvergenceError:  # too few nodes to be simulated: from the reduced model then
            return problem, reduced
        return problem, start

    def _with_drift(self, problem: Problem, found: Fit, name: str) -> Problem:
        """The problem with the rigid drift that is likely at the full model of a fit."""
        try:
            return with_drift(problem, problem.full(self.memory), found, self.stages, name)
        except ConvergenceError:  # the correction will say so
            return problem

    def _anchored(self, problem: Problem, start: Fit) -> tuple[Problem, Fit]:
        """Points followed again from where the fitted model puts them; the reduced model is fitted to them anew."""

        def move(points: np.ndarray) -> np.ndarray:
            model = self.start_model or problem.reduced()
            return replace(model, points=points).positions(start.values)

        anchored = problem.observed.anchored(self.capture, problem.twin, move, self.stages)
        problem = replace(problem, observed=anchored)
        if self.options.own_derivatives:
            return problem, start
        return problem, self.search.fit("reduced_again", problem, started_from(problem.parameters, start))

    def _with_step(self, problem: Problem, start: Fit) -> Problem:
        """The problem with time steps that suit the body's elastic waves, unless the user gave their number.

        A body that strikes something rings with periods of about twice its size over the speed of its waves.
        """
        twin = problem.twin
        if self.options.steps_per_frame is not None or not twin.may_strike:
            return problem
        modulus, density = material_of(twin, start)
        speed = float(np.sqrt(10.0**modulus / density))
        rate = float(np.clip(_STEPS_PER_CROSSING * speed / twin.mesh.size, *_RATES))
        return replace(problem, twin=replace(twin, steps_per_frame=max(4, math.ceil(rate / twin.fps))))

    def _beside(self, problem: Problem, start: Fit) -> FullModel | None:
        """The full model on another mesh, to compare with; what is asked of both there is rolled out ahead."""
        coarse = self.start_model
        if not self.options.own_derivatives or coarse is None:
            return None
        full = problem.full(self.memory)
        mesh = finer_mesh(problem.twin) if coarse.mesh is None else coarse.mesh
        other = full if mesh is None else replace(full, mesh=mesh)
        if full.differenced and not self.stages.known("frame_errors"):  # the search begins with these derivatives
            roll_out_together([(other, start.values)], beside=[(full, start.values)])
        return other

    def _with_errors(self, problem: Problem, other: FullModel, start: Fit) -> Problem:
        """The problem with what more nodes change by frame: after an impact bodies of few nodes soon go astray."""

        def compute() -> Arrays:
            here, there = problem.full(self.memory).begun(start.values), other.positions(start.values)
            return {"errors": _LEFT * frame_errors(problem.seen, here, there)}

        try:
            return replace(problem, errors=self.stages.run("frame_errors", compute)["errors"])
        except ConvergenceError:  # the correction will say so
            return problem

    def _corrected(self, problem: Problem, start: Fit, *, last: bool) -> tuple[Fit, dict[str, np.ndarray], bool]:
        if not self.options.correction:
            return start, {}, start.converged

        def compute() -> dict[str, np.ndarray]:
            most = self.options.full_runs
            full = problem.full(self.memory)
            if self.options.own_derivatives:
                around = problem.drift_limit is None
                settings = FULL_OPTIONS if last else START_OPTIONS
                return arrays_of_correction(
                    fit_full(full, problem.weighted, start, max_runs=most, options=settings, look_around=around)
                )
            return arrays_of_correction(correct(problem.reduced(), full, problem.seen, start, max_runs=most))

        try:
            arrays = self.stages.run("correction", compute)
        except ConvergenceError as error:
            self.options = self.options.replace(correction=False)
            self.warnings.append(
                f"The full model could not be run ({error}): the result is the reduced model's, which is too stiff."
            )
            return start, {}, start.converged
        final = fit_of(arrays, problem.parameters)
        return final, arrays, bool(arrays["correction_converged"]) and final.converged

    def _refitted(self, problem: Problem, found: Fit, converged: bool, *, last: bool) -> tuple[Problem, Fit, bool]:
        """The problem on a mesh of more nodes, if there is one, its fit, and whether that has settled."""
        refitting = Refitting(self.options, self.stages, self.memory, self._with_drift)
        try:
            fine, again = refitting.run(problem, found, last=last)
        except ConvergenceError as error:
            self.warnings.append(f"A mesh of more nodes could not be fitted ({error}): the result is of the twin's.")
            return problem, found, converged
        return fine, again, converged if fine is problem else again.converged

    def _result(
        self,
        problem: Problem,
        start: Fit,
        final: Fit,
        arrays: dict[str, np.ndarray],
        converged: bool,
        *,
        before: Fit | None = None,
    ) -> Refinement:
        full = problem.full(self.memory)
        judged = judge(full, final, problem.seen, self.options, self.stages, self.warnings, before=before)
        final = judged.fit
        field = begun_field(self.capture, self.options, self.stages, self.workers)
        motion = motion_of(self.capture, full, final, self.options, self.stages, mesh=judged.mesh)
        appearance = appearance_of(motion, self.options, self.stages, field, self.warnings.append)
        told = identifiability(final)
        seen, drift = problem.observed.observations, drift_of(problem, final)
        rms = problem.observed.rms(seen.residuals(drifted(problem, final)))
        astray = _not_followed(rms)
        self.warnings += [*astray, *(() if drift is None else drift.sentences())]
        held = [n for n in dict.fromkeys(["log10_youngs_modulus", "poisson_ratio", *self.options.fixed])]
        held = [n for n in held if n not in problem.names]
        values = parameter_values(problem.twin.scene, held) if held else np.zeros(0)
        return Refinement(
            path=str(self.capture.folder),
            estimates=estimates_of(
                final,
                judged.left,
                told,
                problem.seen.frames,
                seen.residual_slices,
                stated=seen.stated,
                followed=not astray,
            ),
            fixed=dict(zip(held, map(float, values), strict=True)),
            covariance=noise_covariance(final),
            reduced_chi_square=final.reduced_chi_square,
            residual_rms=rms,
            nuisances=_nuisances(problem, final),
            drift=drift,
            followed=followed_motion(problem, motion),
            appearance=appearance,
            frame_errors=judged.frame_errors,
            future_rms=future_rms(self.capture, motion),
            identifiability=told,
            history=final.history,
            reduced_values=start.values,
            full_runs=runs_of(arrays),
            converged=converged,
            motion=motion,
            observed_frames=self.capture.observed_frames,
            sources=problem.observed.sources,
            warnings=tuple(dict.fromkeys(self.warnings)),
        )


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
