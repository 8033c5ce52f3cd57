"""Start of the full model's search: the best of several candidates, improved on few nodes with long steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float

from inference.refinement.meshes import comparison_mesh
from inference.refinement.problem import Problem
from inference.refinement.rigid_drift import with_drift_by, with_drift_limit
from inference.refinement.stages import Arrays, RefinementRun
from physconvex import ConvergenceError
from physconvex.identify import (
    Fit,
    FitOptions,
    FullModel,
    RigidDriftObservations,
    WeightedObservations,
    coarse_mesh,
    fit_full,
    misfit_of,
    roll_out_together,
)
from physconvex.mesh import TetMesh

START_OPTIONS = FitOptions(relative_tolerance=1e-3, absolute_tolerance=0.1, max_step=1.5)
_RUNS = 6
_FEW = 0.7  # of the nodes: a larger mesh is hardly cheaper


def coarse_start(
    run: RefinementRun, problem: Problem, reduced: Fit, candidates: Sequence[np.ndarray]
) -> tuple[Problem, Fit, FullModel, TetMesh | None]:
    """The problem with a bound on its drift, the start, the model of few nodes, and another mesh of the body, if any.

    Args:
        run: the refinement.
        problem: the fit's problem.
        reduced: the reduced model's fit.
        candidates: values at which the full model may start, including those of the fit.

    Raises:
        ConvergenceError: a body of few nodes cannot be simulated.
    """
    few_steps = replace(problem.twin, steps_per_frame=max(4, problem.twin.steps_per_frame // 2))
    half = replace(problem.full(run.memory), twin=few_steps)
    mesh = coarse_mesh(run.capture, few_steps.mesh)
    coarse = half if mesh is few_steps.mesh else replace(half, mesh=mesh)
    beside = comparison_mesh(run, problem.twin) if coarse is half else mesh
    other = None  # before a contact meshes hardly differ
    if problem.twin.may_strike and beside is not None:
        other = replace(half, mesh=beside)
    if run.options.drift and other is not None:
        problem = with_drift_limit(run, problem, half, other, reduced)
    start = _best(run, problem, half, other, reduced, candidates)
    model = coarse if len(mesh.vertices) < _FEW * len(few_steps.mesh.vertices) else half
    seen = with_drift_by(run, problem, model, start, "drift_coarse").seen

    def compute() -> Fit:
        look_around = len(candidates) < 2
        found = fit_full(model, seen, start, max_runs=_RUNS, options=START_OPTIONS, look_around=look_around).fit
        if model is not half:
            at_start, at_end = misfits_of(problem, half, (start.values, found.values))
            if at_start < at_end:  # the coarse mesh has misled the search
                found = replace(found, values=start.values)
        return found

    return problem, run.fit("coarse", problem.parameters, compute), coarse, beside


def _best(
    run: RefinementRun,
    problem: Problem,
    half: FullModel,
    other: FullModel | None,
    reduced: Fit,
    candidates: Sequence[np.ndarray],
) -> Fit:
    """The candidate with the full model's smallest misfit: after a rebound, or with locking, the reduced model errs."""
    if len(candidates) < 2:
        return reduced

    def compute() -> Arrays:
        weighted = problem if other is None else _with_errors(problem, half, other, reduced.values)
        return {"misfits": misfits_of(weighted, half, candidates)}

    return replace(reduced, values=candidates[int(np.argmin(run.stages.run("start", compute)["misfits"]))])


def _with_errors(problem: Problem, model: FullModel, other: FullModel, values: np.ndarray) -> Problem:
    """The problem with the difference of two meshes by frame, at the largest drift; as it is if one of them fails."""
    roll_out_together((m, values) for m in (model, other))
    try:
        here, there = model.positions(values), other.positions(values)
    except ConvergenceError:
        return problem
    drift = 0.0 if problem.drift_limit is None else problem.drift_limit[1]
    return replace(problem, errors=replace(problem, drift=drift).errors_between(here, there))


def misfits_of(problem: Problem, model: FullModel, candidates: Sequence[np.ndarray]) -> Float[np.ndarray, " C"]:
    """Misfit of each candidate, infinite if it fails; with drift, minus the log-likelihood at the largest drift.

    Frames are weighted by the model's errors as in the fits: late after a contact they say little about a material.
    """
    roll_out_together((model, values) for values in candidates)
    found: list[np.ndarray | None] = []
    for values in candidates:
        try:
            found.append(model.positions(values))
        except ConvergenceError:
            found.append(None)
    return np.array(model.memory.workers.map(partial(_misfit, problem), found))


def _misfit(problem: Problem, positions: np.ndarray | None) -> float:
    if positions is None:
        return np.inf
    seen = problem.undrifted
    if problem.errors is not None:
        seen = WeightedObservations.by_errors(seen, problem.errors)
    if problem.drift_limit is None:
        return misfit_of(seen, positions)
    begin, most = problem.drift_limit
    return -RigidDriftObservations(seen, begin, 1 / problem.twin.fps, most).log_likelihood(positions)
