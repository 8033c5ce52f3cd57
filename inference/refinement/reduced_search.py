"""The search with the reduced model: a scan over E and ν, then a fit from the best of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from inference.refinement.fits import Scanned, arrays_of_fit, arrays_of_scan, fit_of, scan_of
from inference.refinement.network_start import scan_range
from inference.refinement.options import RefineOptions
from inference.refinement.problem import Problem
from inference.refinement.stages import Stages
from physconvex import ConvergenceError
from physconvex.identify import Fit, FitOptions, Parameter, Twin, TwinOptions, base_twin, coarse_mesh, fit, scan
from physconvex.io import Capture, Workers
from physconvex.reduced import parameter_values

__all__ = ["ReducedSearch", "material_of", "started_from"]

_MODULUS, _RATIO = "log10_youngs_modulus", "poisson_ratio"
_CHEAP_WEIGHTS = 6
_AROUND = (-0.25, 0.0, 0.25, 0.5, 0.75, 1.0)  # decades; eigenmodes are too stiff in contact, so that E wants more
_USUAL_RATIO = 0.3
_PAIRS = 10  # of E and ν that are scanned at least


def started_from(parameters: tuple[Parameter, ...], found: Fit) -> tuple[Parameter, ...]:
    """The parameters, starting where a fit has ended."""
    return tuple(p.at(float(v)) for p, v in zip(parameters, found.values, strict=True))


def material_of(twin: Twin, found: Fit) -> tuple[float, float]:
    """Log10 of E [Pa] and the density [kg/m³] at a fit, whether they were free or not."""
    scene = twin.with_values(found.names, found.values).scene
    modulus, density = parameter_values(scene, [_MODULUS, "density"])
    return float(modulus), float(density)


@dataclass(frozen=True, eq=False)
class ReducedSearch:
    """The search of one refinement.

    Attributes:
        capture, options, stages: of the refinement.
        warnings: what the user should know is added here.
        workers: for what can be done at once.
    """

    capture: Capture
    options: RefineOptions
    stages: Stages
    warnings: list[str]
    workers: Workers = field(default_factory=Workers)
    _made: dict[str, dict[str, np.ndarray]] = field(default_factory=dict, init=False, repr=False)

    def run(self, problem: Problem) -> Fit:
        """Scan and fit, or fit alone where the start is known."""
        names = problem.names
        if _MODULUS not in names or _MODULUS in self.options.initial:
            first = replace(problem, twin=self._cheap(problem)) if self.options.own_derivatives else problem
            return self.fit("reduced", first, problem.parameters)
        starts = self._scanned(problem)
        return fit_of(self.stages.run("reduced", lambda: self._best(problem, starts)), problem.parameters)

    def candidates(self, problem: Problem, found: Fit) -> tuple[np.ndarray, ...]:
        """Where a better model may begin: the fit, the best pairs of the scan, and moduli about that of a free body."""
        if _MODULUS not in problem.names or _MODULUS in self.options.initial:
            return (found.values,)
        scanned = [np.array([p.start for p in start]) for start in self._scanned(problem)]
        around = []
        for change in _AROUND if problem.twin.clamp is None else ():
            values = started_from(problem.parameters, found)
            by_name = {_MODULUS: found.value(_MODULUS) + change, _RATIO: _USUAL_RATIO}
            around.append(np.array([p.at(by_name.get(p.name, p.start)).start for p in values]))
        return found.values, *scanned, *around

    def _scanned(self, problem: Problem) -> Scanned:
        """The best pairs of the scan, which is made once even where stages are not kept."""
        if "scan" not in self._made:
            self._made["scan"] = self.stages.run("scan", lambda: self._scan(problem))
        return scan_of(self._made["scan"], problem.parameters)

    def _cheap(self, problem: Problem) -> Twin:
        """Few weights, few nodes and long steps, the same world: for the scan."""
        given = self.options
        options = TwinOptions(min(_CHEAP_WEIGHTS, given.weights), given.max_nodes, given.steps_per_frame)
        twin = base_twin(self.capture, options, mesh=coarse_mesh(self.capture, problem.twin.mesh))
        own = problem.twin.scene
        twin = twin.with_scene(
            obstacles=own.obstacles,
            initial_velocity=own.initial_velocity,
            initial_angular_velocity=own.initial_angular_velocity,
        )
        if given.held:
            twin = twin.with_values(list(given.held), np.array(list(given.held.values())))
        return replace(twin, steps_per_frame=max(4, twin.steps_per_frame // 2))

    def _scan(self, problem: Problem) -> dict[str, np.ndarray]:
        self.workers.begin(_PAIRS)  # while the network looks where
        where = scan_range(self.capture, problem.twin.mesh.size, self.options)
        if where.note:
            self.warnings.append(where.note)
        frames = problem.windows[0]
        cheap = replace(problem, twin=self._cheap(problem)).first(frames)
        found = scan(
            cheap.reduced(),
            cheap.seen,
            problem.parameters,
            moduli=where.moduli,
            ratios=where.ratios,
            workers=self.workers,
        )
        return arrays_of_scan(found, within=where.predicted)

    def _best(self, problem: Problem, starts: tuple[tuple[Parameter, ...], ...]) -> dict[str, np.ndarray]:
        """A few cheap iterations from the best starts, then the model itself from the best one."""
        cheap = replace(problem, twin=self._cheap(problem))
        grown = self.workers.map(partial(_grown, cheap, self._rough_options(held=cheap.twin.clamp is not None)), starts)
        trials = [trial for trial in grown if trial is not None]
        best = min(trials, key=lambda trial: trial.misfit) if trials else None
        if best is not None and self.options.own_derivatives:
            # a finer reduced model would cost as much as the full one, which comes next
            return arrays_of_fit(best)
        chosen = starts[0] if best is None else started_from(problem.parameters, best)
        return arrays_of_fit(self._fitted(problem, chosen))

    def _fitted(self, problem: Problem, start: tuple[Parameter, ...]) -> Fit:
        return fit(problem.reduced(), problem.seen, start, options=self._reduced_options())

    def _reduced_options(self) -> FitOptions:
        """Where the full model is fitted next, the reduced one need not settle to the last digit."""
        if self.options.own_derivatives:
            return FitOptions(max_iterations=8, relative_tolerance=1e-3, absolute_tolerance=0.1)
        return FitOptions()

    def _rough_options(self, *, held: bool) -> FitOptions:
        """Of the cheap fits: where the full model goes on, from several places, what few steps leave is enough."""
        if self.options.own_derivatives and not held:
            return FitOptions(max_iterations=4, relative_tolerance=0.03)
        return FitOptions(max_iterations=6)

    def fit(self, name: str, problem: Problem, start: tuple[Parameter, ...]) -> Fit:
        """The fit of that stage, from a start."""
        arrays = self.stages.run(name, lambda: arrays_of_fit(self._fitted(problem, start)))
        return fit_of(arrays, problem.parameters)


def _grown(cheap: Problem, options: FitOptions, start: tuple[Parameter, ...]) -> Fit | None:
    """Fit longer and longer parts of the motion; None where the body cannot be simulated.

    Parts that serve to find the right swing leave ν alone, of which they tell next to nothing.
    """
    found = None
    for frames in cheap.windows:
        part = cheap.first(frames)
        free = start if frames == cheap.frames else tuple(p.held() if p.name == _RATIO else p for p in start)
        try:
            found = fit(part.reduced(), part.seen, free, options=options)
        except ConvergenceError:
            return None
        start = started_from(cheap.parameters, found)
    return found
