"""The search goes on on a mesh of more nodes: how a body rebounds hangs on its shape where it lands.

Of few nodes, thin legs are too thick or missing, and the twin's motion parts from the body's by a centimetre per frame
from the landing on, which E and ν then make up for. Meshes of two to three times the nodes, the best of several
meshers, come five times as near.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from inference.refining.beginning import START_OPTIONS
from inference.refining.fits import arrays_of_fit, fit_of
from inference.refining.meshes import fine_mesh
from inference.refining.options import RefineOptions
from inference.refining.problem import Problem
from inference.refining.searching import started_from
from inference.refining.stages import Arrays, Stages
from physconvex.identify import Fit, RollOuts, fit, frame_errors, roll_out_together
from physconvex.identify.full_fit import FULL_OPTIONS

__all__ = ["Refitting"]

_LEFT = 0.25  # of the difference between few and more nodes: what more nodes still err by


@dataclass(frozen=True, eq=False)
class Refitting:
    """The fit on more nodes of one refinement.

    Attributes:
        options, stages: of the refinement.
        memory: of roll-outs.
        with_drift: the problem with the rigid drift that is likely at a fit; the name is of the stage.
    """

    options: RefineOptions
    stages: Stages
    memory: RollOuts
    with_drift: Callable[[Problem, Fit, str], Problem]

    def run(self, problem: Problem, found: Fit, *, last: bool) -> tuple[Problem, Fit]:
        """The problem on a mesh of more nodes, and its fit, begun at `found`; both as they are if there is no mesh.

        Args:
            problem, found: on the twin's mesh.
            last: no search follows, to which this one may leave the last digits.

        Raises:
            ConvergenceError: the body cannot be simulated on it.
        """
        mesh = fine_mesh(problem.twin, self.options, self.stages) if self.options.own_derivatives else None
        if mesh is None:
            return problem, found
        few, fine = problem.full(self.memory), replace(problem, mesh=mesh)
        more = fine.full(self.memory)

        def compare() -> Arrays:
            roll_out_together((model, found.values) for model in (few, more))
            here, there = (model.positions(found.values) for model in (few, more))
            astray = np.sqrt(np.square(there - here).sum(-1).mean())
            return {"errors": _LEFT * frame_errors(problem.seen, there, here), "astray": _LEFT * astray}

        def compute() -> Arrays:
            settings = replace(FULL_OPTIONS if last else START_OPTIONS, max_iterations=self.options.full_runs)
            return arrays_of_fit(fit(more, fine.weighted, started_from(problem.parameters, found), options=settings))

        compared = self.stages.run("fine_errors", compare)
        fine = replace(fine, errors=compared["errors"], astray=float(compared["astray"]))
        fine = self.with_drift(fine, found, "drift_fine")
        return fine, fit_of(self.stages.run("fine", compute), problem.parameters)
