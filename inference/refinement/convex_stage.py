"""The convex twin of a refinement: rendered convexes against all pixels of the videos, coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from inference.refinement.appearance import RestField
from inference.refinement.observations import Observed
from inference.refinement.problem import Problem, is_held, moved_inside, started_from
from inference.refinement.reduced_search import HEIGHT, with_free_height, with_predicted_ratio
from inference.refinement.stages import Arrays, RefinementRun
from physconvex import ConvergenceError, InputError
from physconvex.convex import ConvexField
from physconvex.identify import (
    Fit,
    FitOptions,
    PhotometricObservations,
    ReducedModel,
    RigidDriftObservations,
    SecantModel,
    StackedObservations,
    Twin,
    convex_twin,
    first_contact,
    fit,
    fit_weights,
    misfit_of,
    skinning_weights,
    step_scales,
    with_weights,
)
from physconvex.io import Camera
from physconvex.mesh import TetMesh
from physconvex.numerics import one_torch_thread
from physconvex.reduced import NeuralWeights, NodalWeights, PredictedField, WeightField, predicted_weights

CONVEX = "convex twin"
_OPTIONS = FitOptions(max_iterations=5, relative_tolerance=1e-3)  # of drops from rest, later ones move E by under 0.01
_DRIFTS = (0.01, 0.03, 0.1, 0.3)  # of the speed at the contact: deviations of each later frame's change of velocity
_ENOUGH = 1.5  # the smallest drift is taken whose least misfit is at most so many times that of any
_MODULUS = "log10_youngs_modulus"
_STEPS, _MOVES, _NEAR = (0.2, 0.1), 6, 0.31  # decades: of the search of E, most of each; part of the parabola
_LEAST_FLIGHT = 3  # frames from which the motion at t = 0 is told
_HEIGHTS = (-2.0, -1.0, 0.0, 1.0, 2.0)  # of the floor that are compared [deviations from its mean]


@dataclass(frozen=True, eq=False)
class ConvexFit:
    """The problem of the convex twin at the finest images, and its fit.

    Attributes:
        problem, found: the problem and its fit.
        ratio_sigma: standard deviation of ν, if it is the network's; None if it is fitted.
    """

    problem: Problem
    found: Fit
    ratio_sigma: float | None


def convex_fit(
    run: RefinementRun, problem: Problem, start: Fit, candidates: Sequence[np.ndarray], rest: RestField
) -> ConvexFit | None:
    """The convex twin fitted to the pixels of all videos; None if it is off or impossible.

    Args:
        run: the refinement.
        problem: of the base twin, with its time steps.
        start: of the search.
        candidates: values at which it may start, including those of the search.
        rest: the body's convexes.

    Raises:
        InputError: `stop_after` asks for it and it is impossible.
    """
    wanted, last = run.options.convex, run.options.stop_after is not None
    if not (last or (run.reconstruction is not None if wanted is None else wanted)):
        return None
    try:
        return _fitted(run, problem, start, candidates, rest)
    except (ConvergenceError, InputError) as error:
        if last:
            raise
        run.warnings.append(f"The convex twin was not fitted ({error}).")
        return None


@one_torch_thread()  # many small operations: threads wait for each other
def _fitted(
    run: RefinementRun, problem: Problem, start: Fit, candidates: Sequence[np.ndarray], rest: RestField
) -> ConvexFit | None:
    cameras = _masked(run, problem)
    if not cameras or rest.field is None:
        if run.options.stop_after is not None:
            raise InputError(
                f"{run.capture.folder}: stop_after is 'convex', but there is no video with masks, or no convex field; "
                "add CAMERA_mask.mp4 beside CAMERA.mp4 (physconvex masks finds it), and leave the field on"
            )
        return None
    problem, ratio_sigma = with_predicted_ratio(run, problem)
    problem = with_free_height(run, problem)
    start, candidates = moved_inside(problem.parameters, start, candidates)
    problem, found = _begun(run, replace(problem, twin=_twin(run, problem, start, rest.field)), start, candidates)
    followed = problem.observed
    if not run.options.colours:
        found = run.fit("convex_followed", problem.parameters, partial(_search, problem, found))
    for pixels in run.options.pixels if run.options.colours else ():
        problem = replace(problem, observed=_beside(followed, _photometric(run, cameras, rest.field, pixels)))
        problem = _seen_in(problem, found)
        found = run.fit(f"convex_{pixels}", problem.parameters, partial(_search, problem, found))
    for turn in range(run.options.fit_weights):
        problem = _with_fitted_weights(run, problem, found, f"convex_weights_{turn}")
        found = run.fit(f"convex_turn_{turn}", problem.parameters, partial(_search, problem, found))
    return ConvexFit(problem, found, ratio_sigma)


def _with_fitted_weights(run: RefinementRun, problem: Problem, found: Fit, stage: str) -> Problem:
    """The problem with the network of its weights fitted to the images, at the values and the drift of a fit."""
    twin, weights = problem.twin.with_values(found.names, found.values), problem.twin.scene.body.space.field
    stack = problem.observed.observations
    drawn = [
        (part, where)
        for part, where in zip(stack.parts, stack.point_slices, strict=True)
        if isinstance(part, PhotometricObservations)
    ]
    assert isinstance(weights, NeuralWeights)

    def compute() -> Arrays:
        seen = problem.seen
        shift = None
        if isinstance(seen, RigidDriftObservations):
            drift = seen.drift(problem.reduced.positions(found.values))
            shift = np.concatenate([drift[:, where] for _, where in drawn], axis=1)
        fitted = fit_weights(twin, [part for part, _ in drawn], shift=shift).twin.scene.body.space.field
        assert isinstance(fitted, NeuralWeights)
        return {"theta": fitted.theta.numpy()}

    theta = torch.as_tensor(run.stages.run(stage, compute)["theta"])
    return replace(problem, twin=with_weights(problem.twin, weights.with_theta(theta)))


def _begun(run: RefinementRun, problem: Problem, start: Fit, candidates: Sequence[np.ndarray]) -> tuple[Problem, Fit]:
    """The problem with its drift after the rebound, and the most likely start.

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
    first candidate tells the contact, and again that of the fit, until the contact comes no earlier.
    """
    moving = np.array([name.startswith("initial_") for name in problem.names])
    if not moving.any() or not problem.twin.may_strike:
        return list(candidates)
    values, last = np.array(candidates[0]), problem.frames
    while True:
        begin = _contact(problem, model.positions(values))
        if begin is None or not _LEAST_FLIGHT <= begin < last:
            return [np.where(moving, values, other) for other in candidates]
        flight, last = problem.first(begin), begin
        started = zip(problem.parameters, values, moving, strict=True)
        start = tuple(p.at(v) if m else p.at(v).held() for p, v, m in started)
        values = fit(flight.reduced, flight.seen, start, options=_OPTIONS).values


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


def _beside(followed: Observed, pixels: Observed) -> Observed:
    """Followed points and outlines, and the pixels."""
    stack = StackedObservations.of([followed.observations, pixels.observations])
    return replace(pixels, observations=stack, sources=(*followed.sources, *pixels.sources))


def _seen_in(problem: Problem, found: Fit) -> Problem:
    """The problem with the convexes alone that show in the motion of a fit."""
    stack = problem.observed.observations
    moved = replace(problem.reduced, points=stack.points).positions(found.values)
    pairs = zip(stack.parts, stack.point_slices, strict=True)
    parts = [
        part.visible_in(moved[:, where]) if isinstance(part, PhotometricObservations) else part for part, where in pairs
    ]
    return replace(problem, observed=replace(problem.observed, observations=StackedObservations.of(parts)))


def _search(problem: Problem, found: Fit) -> Fit:
    """The fit at one scale. Derivatives are computed once, and updated with every step."""
    model, seen = problem.reduced, problem.seen
    positions, tangents = model.linearise(found.values)
    if isinstance(seen, RigidDriftObservations):
        seen = seen.begun_at(positions)
    secant = SecantModel(model, found.values, positions, tangents, scales=step_scales(problem.parameters))
    return fit(secant, seen, started_from(problem.parameters, found), options=_OPTIONS)


def _masked(run: RefinementRun, problem: Problem) -> tuple[Camera, ...]:
    """The observed cameras with videos and masks."""
    return tuple(
        c for c in problem.observed.cameras if c in run.capture.filmed and run.capture.mask(c.name) is not None
    )


def _twin(run: RefinementRun, problem: Problem, start: Fit, field: ConvexField) -> Twin:
    """The convex twin with its weights, which are computed once."""
    options = run.options
    moving = problem.twin.with_values(start.names, start.values)
    if options.basis == "predicted":
        return convex_twin(problem.twin, field, _predicted(run, problem.twin))
    if options.basis == "neural":
        return convex_twin(problem.twin, field, "neural", weights=options.weights, moving=moving)
    mesh, basis = problem.twin.mesh, options.basis

    def compute() -> Arrays:
        nodal = skinning_weights(moving, basis, options.weights).nodal_values
        return {"nodal": nodal, "vertices": mesh.vertices, "tets": mesh.tets}

    found = run.stages.run("convex_basis", compute)  # with its mesh: another run may make another one
    stored = TetMesh(found["vertices"], found["tets"])
    return convex_twin(problem.twin, field, NodalWeights(stored, found["nodal"]))


def _predicted(run: RefinementRun, twin: Twin) -> WeightField:
    """The network's weights in the frame of the body at rest: its origin is the centre of the bounding box."""
    from inference.predictor import predict

    found = predict(run.capture.folder, checkpoint=run.options.checkpoint, device=run.options.device)
    assert isinstance(found.skinning_field, PredictedField)
    vertices = twin.surface[0]
    return predicted_weights(found.skinning_field, origin=0.5 * (vertices.min(0) + vertices.max(0)))


def _photometric(run: RefinementRun, cameras: tuple[Camera, ...], field: ConvexField, pixels: int) -> Observed:
    """The videos at a scale at which the object is that many pixels across."""
    capture, parts, sources = run.capture, [], []
    for camera in cameras:
        frames, masks = capture.video(camera.name).frames[: capture.observed_frames], capture.mask(camera.name)
        assert masks is not None
        across = int(np.ptp(np.argwhere(masks[0]), axis=0).max()) + 1
        part = PhotometricObservations.of_video(
            camera, frames, masks[: len(frames)], field, scale=min(1.0, pixels / across), exposure=run.options.exposure
        )
        parts.append(part)
        sources.append(f"camera {camera.name}: {len(part.frames) // 3} pixels")
    return Observed(StackedObservations.of(parts), tuple(sources), cameras)
