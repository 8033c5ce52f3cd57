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
from inference.refinement.stages import RefinementRun
from physconvex import ConvergenceError
from physconvex.identify import (
    Fit,
    FitOptions,
    FullModel,
    coarse_mesh,
    fit_full,
    misfit_of,
    roll_out_together,
)

START_OPTIONS = FitOptions(relative_tolerance=1e-3, absolute_tolerance=0.1, max_step=1.5)
_RUNS = 6
_FEW = 0.7  # of the nodes: a larger mesh is hardly cheaper


def coarse_start(
    run: RefinementRun, problem: Problem, reduced: Fit, candidates: Sequence[np.ndarray]
) -> tuple[Problem, Fit, FullModel]:
    """The problem with a bound on its drift, the start, and the model of few nodes.

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
    if run.options.drift:
        problem = _limited(run, problem, half, coarse, reduced)
    start = _best(run, problem, half, reduced, candidates)
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

    return problem, run.fit("coarse", problem.parameters, compute), coarse


def _limited(run: RefinementRun, problem: Problem, half: FullModel, coarse: FullModel, reduced: Fit) -> Problem:
    other = coarse
    if coarse is half and problem.twin.may_strike:
        mesh = comparison_mesh(problem.twin)
        other = half if mesh is None else replace(half, mesh=mesh)
    return problem if other is half else with_drift_limit(run, problem, half, other, reduced)


def _best(run: RefinementRun, problem: Problem, half: FullModel, reduced: Fit, candidates: Sequence[np.ndarray]) -> Fit:
    """The candidate with the full model's smallest misfit: after a rebound, or with locking, the reduced model errs."""
    if len(candidates) < 2:
        return reduced
    arrays = run.stages.run("start", lambda: {"misfits": misfits_of(problem, half, candidates)})
    return replace(reduced, values=candidates[int(np.argmin(arrays["misfits"]))])


def misfits_of(problem: Problem, model: FullModel, candidates: Sequence[np.ndarray]) -> Float[np.ndarray, " C"]:
    """Misfit of each candidate, infinite if it fails; with drift, minus the log-likelihood at the largest drift."""
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
    if problem.drift_limit is None:
        return misfit_of(problem.undrifted, positions)
    return -problem.with_drift_of(problem.drift_limit[1]).log_likelihood(positions)
