"""The start of the convex twin: motion at t = 0, size of the drift, E and the floor's height, by followed points and
outlines alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from inference.refinement.problem import Problem, is_held
from inference.refinement.reduced_search import HEIGHT
from inference.refinement.stages import Arrays, RefinementRun
from physconvex import ConvergenceError
from physconvex.identify import Fit, FitOptions, ReducedModel, RigidDriftObservations, first_contact, fit, misfit_of

_FLIGHT = FitOptions(max_iterations=5, relative_tolerance=1e-3)
_LEAST_FLIGHT = 3  # frames from which the motion at t = 0 is told
_DRIFTS = (0.01, 0.03, 0.1, 0.3)  # of the speed at the contact: deviations of each later frame's change of velocity
_ENOUGH = 1.5  # the smallest drift is taken whose least misfit is at most so many times that of any
_MODULUS = "log10_youngs_modulus"
_STEPS, _MOVES, _NEAR = (0.2, 0.1), 6, 0.31  # decades: of the search of E, most of each; part of the parabola
_HEIGHTS = (-2.0, -1.0, 0.0, 1.0, 2.0)  # of the floor that are compared [deviations from its mean]


def begun(run: RefinementRun, problem: Problem, start: Fit, candidates: Sequence[np.ndarray]) -> tuple[Problem, Fit]:
    """The problem of the convex twin with its drift after the rebound, and the most likely start.

    Followed points and outlines decide, since pixels see only near motions. A model of few weights rebounds otherwise
    than the body, by a part of the speed at the contact. Drift that explains every rebound would leave E to the small
    deformation alone, so the smallest is taken that explains about as much.
    """
    means = np.array([p.prior_mean if is_held(p) else np.nan for p in problem.parameters])
    candidates = [np.where(np.isnan(means), values, means) for values in candidates]
    candidates = list({tuple(np.round(values, 6)): values for values in candidates}.values())
    found = run.stages.run("convex_start", lambda: _started(run, problem, candidates))
    return _with_drift(problem, tuple(found["drift"].tolist())), replace(start, values=found["values"])


def _with_drift(problem: Problem, drift: tuple[float, ...]) -> Problem:
    """The problem with a drift from a frame on, of a size; without any, if there is none."""
    return replace(problem, drift=drift[1], drift_limit=(int(drift[0]), drift[1])) if drift else problem


def _started(run: RefinementRun, problem: Problem, candidates: Sequence[np.ndarray]) -> Arrays:
    surface = problem.twin.scene.body.space.samples.surface_points if problem.twin.may_strike else np.zeros((0, 3))
    model = replace(problem.reduced, points=np.concatenate([problem.reduced.points, surface]))
    candidates = _in_flight(problem, model, candidates)
    trials = run.workers.map(partial(_likelihoods_by_drift, problem, model, run.options.drift), candidates)
    if not any(np.isfinite(likelihoods).any() for likelihoods, _ in trials):
        raise ConvergenceError("convex twin: the body cannot be simulated at any start")
    best, size = least_drift([likelihoods for likelihoods, _ in trials])
    drift = trials[best][1][size] or ()
    values = np.asarray(candidates[best], dtype=np.float64)
    if _MODULUS in problem.names:
        values = _searched(run, _with_drift(problem, drift), values)
    return {"values": values, "drift": np.array(drift)}


def _in_flight(problem: Problem, model: ReducedModel, candidates: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The candidates with the motion at t = 0, where it is free, that the frames before the first contact tell.

    There the material does not matter, while a worse model has traded the motion for its rebound. The motion of the
    first candidate tells the contact, and again that of the fit, until the contact comes no earlier. The candidates as
    they are, if the body cannot be simulated at the first.
    """
    moving = np.array([name.startswith("initial_") for name in problem.names])
    if not moving.any() or not problem.twin.may_strike:
        return list(candidates)
    values, last = np.array(candidates[0]), problem.frames
    try:
        while True:
            begin = _contact(problem, model.positions(values))
            if begin is None or not _LEAST_FLIGHT <= begin < last:
                return [np.where(moving, values, other) for other in candidates]
            flight, last = problem.first(begin), begin
            started = zip(problem.parameters, values, moving, strict=True)
            start = tuple(p.at(v) if m else p.at(v).held() for p, v, m in started)
            values = fit(flight.reduced, flight.seen, start, options=_FLIGHT).values
    except ConvergenceError:
        return list(candidates)


def _searched(run: RefinementRun, problem: Problem, values: np.ndarray) -> np.ndarray:
    """The values with the most likely log10 E: contacts make the likelihood rough, so a parabola is laid through it.

    Each E has its own most likely height of the floor, where that is free: a stiffer body that lands earlier rebounds
    alike.
    """
    place, tried = problem.names.index(_MODULUS), dict[float, tuple[float, np.ndarray]]()

    def try_at(moduli: Sequence[float]) -> None:
        new = [modulus for modulus in moduli if modulus not in tried]
        found = run.workers.map(partial(_at_best_height, problem), [_replaced(values, place, m) for m in new])
        tried.update(zip(new, found, strict=True))

    best = float(values[place])
    try_at([best])
    for step in _STEPS:
        for _ in range(_MOVES):
            try_at([round(best - step, 6), round(best + step, 6)])
            last, best = best, max(tried, key=lambda modulus: tried[modulus][0])
            if best == last:
                break
    near = sorted(m for m in tried if abs(m - best) <= _NEAR and np.isfinite(tried[m][0]))
    if not near:
        return values
    if len(near) > 3:
        best = _top(near, [tried[m][0] for m in near], (best - _NEAR, best + _NEAR))[0]
    columns = np.array([tried[m][1] for m in near]).T  # a height of the floor goes with its E
    return np.array([np.interp(best, near, column) for column in columns])


def _at_best_height(problem: Problem, values: np.ndarray) -> tuple[float, np.ndarray]:
    """Log-likelihood of values with the most likely height of the floor, its prior included, and these values.

    Motions at other heights lie on the line through those at one deviation below and above the mean.
    """
    if HEIGHT not in problem.names or is_held(problem.parameters[problem.names.index(HEIGHT)]):
        return _likelihood(problem, values), values
    place = problem.names.index(HEIGHT)
    mean, sigma = problem.parameters[place].prior_mean, problem.parameters[place].prior_sigma
    try:
        low, high = (problem.reduced.positions(_replaced(values, place, mean + side * sigma)) for side in (-1, 1))
    except ConvergenceError:
        return -np.inf, values
    likelihoods = [_likely(problem, 0.5 * (low + high + z * (high - low))) - 0.5 * z**2 for z in _HEIGHTS]
    middle = min(max(int(np.argmax(likelihoods)), 1), len(_HEIGHTS) - 2)
    first, last = middle - 1, middle + 2
    height, likelihood = _top(_HEIGHTS[first:last], likelihoods[first:last], (_HEIGHTS[0], _HEIGHTS[-1]))
    return likelihood, _replaced(values, place, mean + height * sigma)


def _top(places: Sequence[float], values: Sequence[float], within: tuple[float, float]) -> tuple[float, float]:
    """Place and value of the top of a parabola through values, within bounds; of the largest, if it has none."""
    middle = float(np.mean(places))
    curve = np.polyfit(np.subtract(places, middle), values, 2)
    if curve[0] >= 0:
        best = int(np.argmax(values))
        return places[best], values[best]
    top = float(np.clip(middle - 0.5 * curve[1] / curve[0], *within))
    return top, float(np.polyval(curve, top - middle))


def _replaced(values: np.ndarray, place: int, value: float) -> np.ndarray:
    out = values.copy()
    out[place] = value
    return out


def _likelihood(problem: Problem, values: np.ndarray) -> float:
    """Log-likelihood of values, the drift integrated out; −∞ if the body cannot be simulated."""
    try:
        return _likely(problem, problem.reduced.positions(values))
    except ConvergenceError:
        return -np.inf


def _likely(problem: Problem, positions: np.ndarray) -> float:
    seen = problem.seen
    return seen.log_likelihood(positions) if isinstance(seen, RigidDriftObservations) else -misfit_of(seen, positions)


def least_drift(likelihoods: Sequence[Sequence[float]]) -> tuple[int, int]:
    """Candidate and size of drift: the smallest size at which a candidate fits about as well as any at any size.

    Args:
        likelihoods: log-likelihoods of each candidate, by sizes in ascending order; negative.
    """
    most = max(max(row) for row in likelihoods)
    for size in range(max(len(row) for row in likelihoods)):
        column = [row[size] if size < len(row) else -np.inf for row in likelihoods]
        best = int(np.argmax(column))
        if column[best] >= _ENOUGH * most:
            return best, size
    raise AssertionError("one of them is the most likely")


def _likelihoods_by_drift(
    problem: Problem, model: ReducedModel, drifts: bool, values: np.ndarray
) -> tuple[list[float], list[tuple[int, float] | None]]:
    """Log-likelihood of values without drift, and with drifts of several sizes; those drifts.

    The model moves the observed points, and after them those of the surface, which tell the first contact.
    """
    twin = problem.twin
    try:
        both = model.positions(values)
    except ConvergenceError:
        return [-np.inf], [None]
    positions = both[:, : len(problem.seen.points)]
    likelihoods: list[float] = [-misfit_of(problem.seen, positions)]
    sizes: list[tuple[int, float] | None] = [None]
    if not drifts or not twin.may_strike:
        return likelihoods, sizes
    begin = _contact(problem, both)
    if begin is None or begin >= len(both):
        return likelihoods, sizes
    speed = twin.fps * float(np.linalg.norm((both[begin] - both[begin - 1])[positions.shape[1] :].mean(axis=0)))
    for share in _DRIFTS:
        one = RigidDriftObservations(problem.undrifted, begin, 1 / twin.fps, share * speed)
        likelihoods.append(one.log_likelihood(positions))
        sizes.append((begin, share * speed))
    return likelihoods, sizes


def _contact(problem: Problem, positions: np.ndarray) -> int | None:
    """First frame with a contact, from positions of the observed points and, after them, of those of the surface."""
    twin, moved = problem.twin, positions[:, len(problem.seen.points) :]
    return first_contact(moved, twin.scene.obstacles, np.arange(len(moved)) / twin.fps, twin.scene.gravity)
