"""The fit to colours; where these lose the body, from another material too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from inference.refinement.coarse_start import misfits_of
from inference.refinement.colour_observations import WIDE, blur_for, coloured
from inference.refinement.fits import arrays_of_fit, fit_of
from inference.refinement.observations import Observed
from inference.refinement.options import RefineOptions
from inference.refinement.problem import Problem
from inference.refinement.reduced_search import started_from
from inference.refinement.restart import colours_lost, materials_about
from inference.refinement.stages import Arrays, Stages
from physconvex import ConvergenceError
from physconvex.identify import FULL_OPTIONS, Fit, FullModel, ReducedModel, RollOuts, fit
from physconvex.io import Capture

__all__ = ["ColourSearch"]

_LOST = 5.0  # times the colours' residuals in flight: after a contact they lie elsewhere


@dataclass(frozen=True, eq=False)
class ColourSearch:
    """The search of one refinement.

    Attributes:
        capture, options, stages: of the refinement.
        memory: of roll-outs.
        warnings: what the user should know is added here.
        with_drift: the problem with the rigid drift that is likely at a fit; the name is of the stage.
    """

    capture: Capture
    options: RefineOptions
    stages: Stages
    memory: RollOuts
    warnings: list[str]
    with_drift: Callable[[Problem, Fit, str], Problem]

    def run(self, problem: Problem, found: Fit) -> tuple[Problem, Fit]:
        """The problem with colours in the place of the points followed, and its fit from another one."""
        kept = problem
        try:
            kept, found = self._fitted(problem, found, blur_for(problem))
            if self.options.own_derivatives and (lost := colours_lost(kept, found)) > _LOST:
                kept, found = self._elsewhere(problem, kept, found, lost)
        except ConvergenceError as error:
            self.warnings.append(f"Colours were not compared, or not again: the model failed ({error}).")
        return kept, found

    def _fitted(self, problem: Problem, found: Fit, blur: float, name: str = "") -> tuple[Problem, Fit]:
        trial = replace(problem, observed=self._coloured(problem, found, blur))
        trial = self.with_drift(trial, found, f"drift_{blur:g}{name}")
        start = started_from(problem.parameters, found)
        model = trial.full(self.memory) if self.options.own_derivatives else trial.reduced()

        def compute() -> Arrays:
            return arrays_of_fit(fit(model, trial.weighted, start, options=FULL_OPTIONS))

        return trial, fit_of(self.stages.run(f"colours_{blur:g}{name}", compute), problem.parameters)

    def _elsewhere(self, problem: Problem, kept: Problem, found: Fit, lost: float) -> tuple[Problem, Fit]:
        """The fit from the material about that widely blurred colours like best, if it follows the body better."""
        values = materials_about(problem, found)

        def compute() -> Arrays:
            wide = replace(kept, observed=self._coloured(problem, found, WIDE))
            return {"misfits": misfits_of(wide, wide.full(self.memory), values)}

        best = int(np.argmin(self.stages.run("elsewhere", compute)["misfits"]))
        if best == 0:
            return kept, found
        there, moved = kept, replace(found, values=values[best])
        for blur in dict.fromkeys((WIDE, blur_for(problem))):
            there, moved = self._fitted(problem, moved, blur, "_elsewhere")
        return (there, moved) if colours_lost(there, moved) < lost else (kept, found)

    def _coloured(self, problem: Problem, found: Fit, blur: float) -> Observed:
        model: FullModel | ReducedModel = problem.full(self.memory) if self.options.correction else problem.reduced()
        return coloured(problem.observed, self.capture, problem.twin, model, found, self.options, blur)
