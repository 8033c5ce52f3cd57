"""The search with the reduced model: a scan over E and ν, then a fit from the best pair.

The scan is fine around the network's prediction and coarse elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from inference.refinement.problem import HELD, Problem, started_from
from inference.refinement.result import StageEstimate, deviation_of
from inference.refinement.stages import Arrays, RefinementRun, Scanned, arrays_of_scan, scan_of
from physconvex import ConvergenceError, InputError
from physconvex.identify import (
    Fit,
    FitOptions,
    Parameter,
    Twin,
    TwinOptions,
    base_twin,
    coarse_mesh,
    default_parameter,
    fit,
    scan,
    scan_values,
)
from physconvex.reduced import parameter_values

HEIGHT = "floor_height"
_MODULUS, _RATIO = "log10_youngs_modulus", "poisson_ratio"
_WITHIN = 5e-3  # distance of the bounds of ν that is held
_CHEAP_WEIGHTS = 6
_AROUND = (-0.25, 0.0, 0.25, 0.5, 0.75, 1.0)  # decades; eigenmodes are too stiff in contact, so that E must be larger
_USUAL_RATIO = 0.3
_PAIRS = 10  # least number of scanned pairs of E and ν
_RATIOS = (0.25, 0.45)
_LEAST = 0.4  # half width of the scan around a prediction [decades]
_APART = 0.2  # least distance of further scanned moduli from the predicted interval [decades]


@dataclass(frozen=True, eq=False)
class ReducedSearch:
    """The search of one refinement.

    Attributes:
        run: the refinement.
    """

    run: RefinementRun
    _made: dict[str, Arrays] = field(default_factory=dict, init=False, repr=False)

    def start(self, problem: Problem) -> Fit:
        """Scan and fit, or fit alone where the start is known."""
        names = problem.names
        if _MODULUS not in names or _MODULUS in self.run.options.initial:
            first = replace(problem, twin=self._cheap(problem)) if self.run.options.own_derivatives else problem
            return self.fit("reduced", first, problem.parameters)
        starts = self._scanned(problem)
        return self.run.fit("reduced", problem.parameters, lambda: self._best(problem, starts))

    def candidates(self, problem: Problem, found: Fit) -> tuple[np.ndarray, ...]:
        """Starts of a better model: the fit, the best pairs of the scan, and, for a free body, moduli near the fit."""
        if _MODULUS not in problem.names or _MODULUS in self.run.options.initial:
            return (found.values,)
        scanned = [np.array([p.start for p in start]) for start in self._scanned(problem)]
        around = []
        for change in _AROUND if problem.twin.clamp is None else ():
            values = started_from(problem.parameters, found)
            by_name = {_MODULUS: found.value(_MODULUS) + change, _RATIO: _USUAL_RATIO}
            around.append(np.array([p.at(by_name.get(p.name, p.start)).start for p in values]))
        return found.values, *scanned, *around

    def _scanned(self, problem: Problem) -> Scanned:
        """The best pairs of the scan, which runs once even if stages are not kept."""
        if "scan" not in self._made:
            self._made["scan"] = self.run.stages.run("scan", lambda: self._scan(problem))
        return scan_of(self._made["scan"], problem.parameters)

    def _cheap(self, problem: Problem) -> Twin:
        """Few weights, few nodes and long steps, the same world: for the scan."""
        given = self.run.options
        options = TwinOptions(min(_CHEAP_WEIGHTS, given.weights), given.max_nodes, given.steps_per_frame)
        twin = base_twin(self.run.capture, options, mesh=coarse_mesh(self.run.capture, problem.twin.mesh))
        own = problem.twin.scene
        twin = twin.with_scene(
            obstacles=own.obstacles,
            initial_velocity=own.initial_velocity,
            initial_angular_velocity=own.initial_angular_velocity,
        )
        if given.held:
            twin = twin.with_values(list(given.held), np.array(list(given.held.values())))
        return replace(twin, steps_per_frame=max(4, twin.steps_per_frame // 2))

    def _scan(self, problem: Problem) -> Arrays:
        self.run.workers.begin(_PAIRS)  # while the network predicts the start
        where = scan_range(self.run, problem.twin.mesh.size)
        if where.note:
            self.run.warnings.append(where.note)
        frames = problem.windows[0]
        cheap = replace(problem, twin=self._cheap(problem)).first(frames)
        found = scan(
            cheap.reduced, cheap.seen, problem.parameters,
            moduli=where.moduli, ratios=where.ratios, workers=self.run.workers,
        )  # fmt: skip
        return arrays_of_scan(found, within=where.predicted)

    def _best(self, problem: Problem, starts: Scanned) -> Fit:
        """A few cheap iterations from the best starts, then a fit of the model itself from the best one."""
        cheap = replace(problem, twin=self._cheap(problem))
        own_derivatives, options = self.run.options.own_derivatives, FitOptions(max_iterations=6)
        if own_derivatives and cheap.twin.clamp is None:  # the full model goes on from several starts: few steps do
            options = FitOptions(max_iterations=4, relative_tolerance=0.03)
        grown = self.run.workers.map(partial(_grown, cheap, options), starts)
        trials = [trial for trial in grown if trial is not None]
        best = min(trials, key=lambda trial: trial.misfit) if trials else None
        if best is not None and own_derivatives:  # a finer reduced model would cost as much as the full one, the next
            return best
        return self._fitted(problem, starts[0] if best is None else started_from(problem.parameters, best))

    def _fitted(self, problem: Problem, start: tuple[Parameter, ...]) -> Fit:
        options = FitOptions()
        if self.run.options.own_derivatives:  # the full model follows: the last digits need not converge
            options = FitOptions(max_iterations=8, relative_tolerance=1e-3, absolute_tolerance=0.1)
        return fit(problem.reduced, problem.seen, start, options=options)

    def fit(self, name: str, problem: Problem, start: tuple[Parameter, ...]) -> Fit:
        """The fit of that stage, from a start."""
        return self.run.fit(name, problem.parameters, lambda: self._fitted(problem, start))


def _grown(cheap: Problem, options: FitOptions, start: tuple[Parameter, ...]) -> Fit | None:
    """Fit increasing parts of the motion; None if the body cannot be simulated.

    Parts that only find the right swing keep ν fixed, since they hardly determine it.
    """
    found = None
    for frames in cheap.windows:
        part = cheap.first(frames)
        free = start if frames == cheap.frames else tuple(p.held() if p.name == _RATIO else p for p in start)
        try:
            found = fit(part.reduced, part.seen, free, options=options)
        except ConvergenceError:
            return None
        start = started_from(cheap.parameters, found)
    return found


@dataclass(frozen=True)
class ScanRange:
    """The scan's values.

    Attributes:
        moduli: log10 E.
        ratios: ν.
        predicted: ends of the prediction's log10 E; a start within them is always kept; None: no prediction.
        note: for the user, "" for none.
    """

    moduli: tuple[float, ...]
    ratios: tuple[float, ...]
    predicted: tuple[float, float] | None = None
    note: str = ""


def scan_range(run: RefinementRun, size: float) -> ScanRange:
    """The scan for a body of that size [m].

    Raises:
        InputError: a prediction is requested and impossible.
    """
    capture, options = run.capture, run.options
    gravity = float(np.linalg.norm(capture.gravity))
    everywhere = scan_values(density=capture.density, gravity=gravity, size=size)
    if options.start == "scan" or (options.start == "auto" and not capture.filmed):
        return ScanRange(everywhere, _RATIOS)
    try:
        moduli, ratios = _around(predicted(run))
    except InputError as error:
        if options.start == "predict":
            raise
        return ScanRange(everywhere, _RATIOS, note=f"The network gave no start ({error}); the whole range was scanned.")
    low, high = moduli[0], moduli[-1]
    beyond = everywhere if options.start == "auto" else ()
    others = [value for value in beyond if not low - _APART <= value <= high + _APART]
    return ScanRange(tuple(sorted((*moduli, *others))), ratios, (low, high))


def predicted(run: RefinementRun) -> StageEstimate:
    """The network's E and ν.

    Raises:
        InputError: the capture holds no video that it reads.
    """

    def compute() -> Arrays:
        from inference.predictor import predict

        found = predict(run.capture.folder, checkpoint=run.options.checkpoint, device=run.options.device)
        modulus = np.log10([found.youngs_modulus, *found.youngs_modulus_interval])
        return {"estimate": np.array([modulus, [found.poisson_ratio, *found.poisson_ratio_interval]])}

    modulus, ratio = run.stages.run("network", compute)["estimate"].tolist()
    return StageEstimate("network", modulus[0], ratio[0], ((modulus[1], modulus[2]), (ratio[1], ratio[2])))


def with_predicted_ratio(run: RefinementRun, problem: Problem) -> tuple[Problem, float | None]:
    """The problem with ν held at the network's, and that one's standard deviation.

    As it is, and None, if there is no prediction, or ν is fixed or has a prior. A model of few weights, or of a body
    from pictures, tells ν worse than the network: it takes for ν what the missing weights or the wrong volume do.
    """
    if not run.stages.known("network"):
        return problem, None
    told, parameters = predicted(run), {p.name: p for p in problem.parameters}
    free, interval = parameters.get(_RATIO), told.intervals[1]
    if free is None or interval is None or np.isfinite(free.prior_sigma):
        return problem, None
    value, sigma = free.at(told.poisson_ratio).start, deviation_of(interval)
    parameters[_RATIO] = replace(
        free, start=value, lower=value - _WITHIN, upper=value + _WITHIN, prior_mean=value, prior_sigma=HELD * free.step
    )
    run.warnings.append(
        f"Poisson's ratio is the network's, {value:.2f} ± {sigma:.2f}, and is not fitted; a prior of your own "
        "(--prior poisson_ratio=MEAN,SIGMA) lets it be fitted."
    )
    return replace(problem, parameters=tuple(parameters.values())), sigma


def with_free_height(run: RefinementRun, problem: Problem) -> Problem:
    """The problem with the floor's height free within the error of the reconstructed body, which decides when it lands.

    As it is with a given body, without a floor, and where the user states the height.
    """
    made, twin = run.reconstruction, problem.twin
    if made is None or made.error is None or not twin.may_strike or run.options.states(HEIGHT):
        return problem
    height = float(parameter_values(twin.scene, [HEIGHT])[0])
    free = replace(default_parameter(HEIGHT, start=height), prior_mean=height, prior_sigma=made.error.deviation)
    return replace(problem, parameters=(*problem.parameters, free))


def _around(found: StageEstimate) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Five moduli over the 90 % interval, enlarged to 0.8 decades at least, and two ratios."""
    assert found.intervals[0] is not None
    low, high = found.intervals[0]
    middle = 0.5 * (low + high)
    half = max(0.5 * (high - low), _LEAST)
    ratio = float(np.clip(found.poisson_ratio, 0.05, 0.48))
    return tuple(np.linspace(middle - half, middle + half, 5)), tuple(dict.fromkeys((ratio, 0.3, 0.45)))[:2]
