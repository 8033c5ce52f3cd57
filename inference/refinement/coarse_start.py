"""Where the full model's search begins: the best of several places, improved on few nodes with long steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from inference.refinement.fits import arrays_of_fit, fit_of
from inference.refinement.meshes import finer_mesh
from inference.refinement.problem import Problem
from inference.refinement.rigid_drift import with_drift, with_drift_limit
from inference.refinement.stages import Stages
from physconvex import ConvergenceError
from physconvex.identify import (
    Fit,
    FitOptions,
    FullModel,
    RollOuts,
    coarse_mesh,
    fit_full,
    misfit_of,
    roll_out_together,
)
from physconvex.io import Capture

__all__ = ["START_OPTIONS", "Beginning", "misfits_of"]

START_OPTIONS = FitOptions(relative_tolerance=1e-3, absolute_tolerance=0.1, max_step=1.5)
_RUNS = 6
_FEW = 0.7  # of the nodes: a mesh with more of them is hardly cheaper


@dataclass(frozen=True, eq=False)
class Beginning:
    """The search for a start.

    Attributes:
        capture, stages: of the refinement.
        memory: of roll-outs.
        drift: whether rigid drift is thought of.
    """

    capture: Capture
    stages: Stages
    memory: RollOuts
    drift: bool

    def find(self, problem: Problem, reduced: Fit, candidates: Sequence[np.ndarray]) -> tuple[Problem, Fit, FullModel]:
        """The problem with a bound on its drift, the start, and the model of few nodes.

        Args:
            problem: what is fitted.
            reduced: the reduced model's fit.
            candidates: values from which the full model may begin, that of the fit among them.

        Raises:
            ConvergenceError: a body of few nodes cannot be simulated.
        """
        swift = replace(problem.twin, steps_per_frame=max(4, problem.twin.steps_per_frame // 2))
        half = replace(problem.full(self.memory), twin=swift)
        mesh = coarse_mesh(self.capture, swift.mesh)
        coarse = half if mesh is swift.mesh else replace(half, mesh=mesh)
        if self.drift:
            problem = self._limited(problem, half, coarse, reduced)
        start = self._best(problem, half, reduced, candidates)
        model = coarse if len(mesh.vertices) < _FEW * len(swift.mesh.vertices) else half
        return problem, self._fitted(problem, model, half, start, around=len(candidates) < 2), coarse

    def _limited(self, problem: Problem, half: FullModel, coarse: FullModel, reduced: Fit) -> Problem:
        other = coarse
        if coarse is half and problem.twin.may_strike:
            finer = finer_mesh(problem.twin)
            other = half if finer is None else replace(half, mesh=finer)
        return problem if other is half else with_drift_limit(problem, half, other, reduced, self.stages)

    def _best(self, problem: Problem, half: FullModel, reduced: Fit, candidates: Sequence[np.ndarray]) -> Fit:
        """The candidate that the full model likes best: a rebound, or locking, may have led the reduced one astray."""
        if len(candidates) < 2:
            return reduced
        arrays = self.stages.run("start", lambda: {"misfits": misfits_of(problem, half, candidates)})
        values = candidates[int(np.argmin(arrays["misfits"]))]
        return reduced if values is candidates[0] else replace(reduced, values=values)

    def _fitted(self, problem: Problem, model: FullModel, half: FullModel, start: Fit, *, around: bool) -> Fit:
        seen = with_drift(problem, model, start, self.stages, "drift_coarse").seen

        def compute() -> dict[str, np.ndarray]:
            found = fit_full(model, seen, start, max_runs=_RUNS, options=START_OPTIONS, look_around=around).fit
            if model is not half:
                before, after = misfits_of(problem, half, (start.values, found.values))
                if before < after:  # few nodes have led astray
                    found = replace(found, values=start.values)
            return arrays_of_fit(found)

        return fit_of(self.stages.run("coarse", compute), problem.parameters)


def misfits_of(problem: Problem, model: FullModel, candidates: Sequence[np.ndarray]) -> Float[np.ndarray, " C"]:
    """Of each candidate, infinite where nothing comes out; with drift, all there may be, minus its log-likelihood."""
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
    return -problem.drifting(problem.drift_limit[1]).log_likelihood(positions)
