"""Continues the search on a mesh of more nodes, since the rebound of a body depends on its shape at the contact.

With few nodes, thin legs are too thick or missing. The twin's motion then deviates from the body's by a centimetre per
frame after the landing, and E and ν compensate for it. The best of several meshes with two to five times the nodes is
two to five times as accurate. The coarse mesh may lead to another rebound, so that nearby materials are tried first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from inference.refinement.coarse_start import START_OPTIONS, misfits_of
from inference.refinement.meshes import fine_mesh
from inference.refinement.problem import Problem, in_pixels, started_from, tried
from inference.refinement.rigid_drift import with_drift
from inference.refinement.stages import Arrays, RefinementRun
from physconvex.identify import (
    FULL_OPTIONS,
    LEFT_BY_FITTED,
    Fit,
    FullModel,
    fit,
    frame_errors,
    roll_out_together,
)

# decades of E from the start, then further on the better side, and ν with them
_BESIDE, _FURTHER, _RATIO = 0.15, (0.3, 0.45), 0.35
_RATIOS = (0.25, 0.45)  # besides the best of these
_ALIKE = 2.0  # pixels between the motions of both meshes, below which videos hardly distinguish them


def fit_on_more_nodes(run: RefinementRun, problem: Problem, found: Fit, *, last: bool) -> tuple[Problem, Fit]:
    """The problem on a mesh of more nodes, and its fit, started at `found`.

    Both stay as they are if there is no mesh, or if videos hardly distinguish it from the twin's. If no nearby modulus
    has a smaller misfit, the fit is left to the next search.

    Args:
        run: the refinement.
        problem, found: on the twin's mesh.
        last: no search follows that could refine the last digits.

    Raises:
        ConvergenceError: the body cannot be simulated on it.
    """
    mesh = fine_mesh(run, problem.twin, found) if run.options.own_derivatives else None
    if mesh is None:
        return problem, found
    few, fine = problem.full(run.memory), replace(problem, mesh=mesh)
    more = fine.full(run.memory)

    def both(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        roll_out_together((model, values) for model in (few, more))
        return few.positions(values), more.positions(values)

    arrays = run.stages.run("fine_apart", lambda: {"apart": np.array(_apart(*both(found.values)))})
    if problem.observed.cameras and in_pixels(problem, float(arrays["apart"])) < _ALIKE:
        return problem, found
    values = run.stages.run("fine_start", lambda: {"values": _material(problem, more, found.values)})["values"]
    start = replace(found, values=values)

    def compare() -> Arrays:
        here, there = both(start.values)
        errors = LEFT_BY_FITTED * frame_errors(problem.seen, there, here)
        return {"errors": errors, "astray": np.array(LEFT_BY_FITTED * _apart(here, there))}

    def compute() -> Fit:
        settings = replace(FULL_OPTIONS if last else START_OPTIONS, max_iterations=run.options.full_runs)
        return fit(more, fine.weighted, started_from(problem.parameters, start), options=settings)

    compared = run.stages.run("fine_errors", compare)
    fine = replace(fine, errors=compared["errors"], astray=float(compared["astray"]))
    if not last and np.array_equal(values, found.values):
        return fine, found
    fine = with_drift(run, fine, start, "drift_fine")
    return fine, run.fit("fine", problem.parameters, compute)


def _apart(here: Float[np.ndarray, "T P 3"], there: Float[np.ndarray, "T P 3"]) -> float:
    return float(np.sqrt(np.square(there - here).sum(-1).mean()))


def _material(problem: Problem, model: FullModel, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
    """The values with the smallest misfit, of a fit's values and those of nearby materials."""
    beside = [_moved(problem, values, change, _RATIO) for change in (-_BESIDE, _BESIDE)]
    best = _best(problem, model, [values, *beside])
    if best is values:
        return values
    side = -1.0 if best is beside[0] else 1.0
    best = _best(problem, model, [best, *(_moved(problem, values, side * change, _RATIO) for change in _FURTHER)])
    others = [_moved(problem, best, 0.0, ratio) for ratio in _RATIOS]
    return _best(problem, model, [best, *(other for other in others if not np.array_equal(other, best))])


def _moved(problem: Problem, values: np.ndarray, change: float, ratio: float) -> Float[np.ndarray, " K"]:
    """Values with E changed by that many decades and that ν, as far as these are free and within their bounds."""
    wanted = {"log10_youngs_modulus": lambda value: value + change, "poisson_ratio": lambda value: ratio}
    pairs = zip(problem.parameters, map(float, values), strict=True)
    return np.array([tried(p.at(v), [wanted[p.name](v)])[0] if p.name in wanted else v for p, v in pairs])


def _best(problem: Problem, model: FullModel, candidates: Sequence[np.ndarray]) -> np.ndarray:
    return candidates[int(np.argmin(misfits_of(problem, model, candidates)))]
