"""The convex twin of a refinement: rendered convexes against all pixels of the videos, coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from inference.refinement.appearance import RestField
from inference.refinement.observations import Observed
from inference.refinement.problem import Problem, started_from
from inference.refinement.stages import Arrays, RefinementRun
from physconvex import ConvergenceError, InputError
from physconvex.convex import ConvexField
from physconvex.identify import (
    Fit,
    FitOptions,
    PhotometricObservations,
    RigidDriftObservations,
    StackedObservations,
    Twin,
    convex_twin,
    first_contact,
    fit,
    fit_weights,
    misfit_of,
    skinning_weights,
    with_weights,
)
from physconvex.io import Camera
from physconvex.reduced import NeuralWeights, NodalWeights, PredictedField, WeightField, predicted_weights

CONVEX = "convex twin"
_LEVELS = (24, 48, 96)  # compared pixels across the object, coarse to fine
_DRAWN = 0.01  # least opacity of a convex that is drawn
_OPTIONS = tuple(FitOptions(max_iterations=n, relative_tolerance=1e-3) for n in (6, 4, 3))
_DRIFT = 0.05  # of the speed at the first contact: deviation of each frame's change of velocity
_DRIFT_TURNS = 2


@dataclass(frozen=True, eq=False)
class ConvexFit:
    """The problem of the convex twin at the finest images, and its fit."""

    problem: Problem
    found: Fit


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


def _fitted(
    run: RefinementRun, problem: Problem, start: Fit, candidates: Sequence[np.ndarray], rest: RestField
) -> ConvexFit | None:
    cameras = _masked(run, problem)
    if not cameras or rest.field is None:
        if run.options.stop_after is not None:
            raise InputError(
                f"{run.capture.folder}: stop_after is 'convex', but there is no video with masks, or no convex field; "
                "add CAMERA_mask.mp4 beside CAMERA.mp4, and leave the field on"
            )
        return None
    twin = _twin(run, problem, start, rest.field)
    drawn = rest.field.select(rest.field.opacity > _DRAWN)
    problem, found = _drifting(run, replace(problem, twin=twin), start), start
    for number, pixels in enumerate(_LEVELS):
        problem = _seen_in(replace(problem, observed=_photometric(run, cameras, drawn, pixels)), found)
        if number == 0 and len(candidates) > 1:
            found = _nearest(run, problem, found, candidates)
        found = run.fit(f"convex_{pixels}", problem.parameters, partial(_search, problem, found, _OPTIONS[number]))
    for turn in range(run.options.fit_weights):
        problem = _with_fitted_weights(run, problem, found, f"convex_weights_{turn}")
        found = run.fit(f"convex_turn_{turn}", problem.parameters, partial(_search, problem, found, _OPTIONS[-1]))
    return ConvexFit(problem, found)


def _with_fitted_weights(run: RefinementRun, problem: Problem, found: Fit, stage: str) -> Problem:
    """The problem with the network of its weights fitted to the images, at the values and the drift of a fit."""
    twin, weights = problem.twin.with_values(found.names, found.values), problem.twin.scene.body.space.field
    parts = [p for p in problem.observed.observations.parts if isinstance(p, PhotometricObservations)]
    assert isinstance(weights, NeuralWeights)

    def compute() -> Arrays:
        seen = problem.seen
        shift = None
        if isinstance(seen, RigidDriftObservations):
            shift = seen.drift(problem.reduced().positions(found.values))
        fitted = fit_weights(twin, parts, shift=shift).twin.scene.body.space.field
        assert isinstance(fitted, NeuralWeights)
        return {"theta": fitted.theta.numpy()}

    theta = torch.as_tensor(run.stages.run(stage, compute)["theta"])
    return replace(problem, twin=with_weights(problem.twin, weights.with_theta(theta)))


def _seen_in(problem: Problem, found: Fit) -> Problem:
    """The problem with the convexes alone that show in the motion of a fit."""
    stack = problem.observed.observations
    moved = replace(problem.reduced(), points=stack.points).positions(found.values)
    parts = []
    for part, where in zip(stack.parts, stack.point_slices, strict=True):
        assert isinstance(part, PhotometricObservations)
        parts.append(part.visible_in(moved[:, where]))
    return replace(problem, observed=replace(problem.observed, observations=StackedObservations.of(parts)))


def _drifting(run: RefinementRun, problem: Problem, start: Fit) -> Problem:
    """The problem with the rigid drift that a rebound of few weights has from the true one."""
    twin = problem.twin
    if not run.options.drift or not twin.may_strike:
        return problem
    points = twin.scene.body.space.samples.surface_points
    moved = replace(problem.reduced(), points=points).positions(start.values)
    begin = first_contact(moved, twin.scene.obstacles, np.arange(len(moved)) / twin.fps, twin.scene.gravity)
    if begin is None or begin >= len(moved):
        return problem
    speed = twin.fps * float(np.linalg.norm((moved[begin] - moved[begin - 1]).mean(axis=0)))
    return replace(problem, drift=_DRIFT * speed, drift_limit=(begin, _DRIFT * speed))


def _search(problem: Problem, found: Fit, options: FitOptions) -> Fit:
    """The fit at one scale, with the drift linearised about the most likely one, twice."""
    model, seen = problem.reduced(), problem.seen
    for _ in range(_DRIFT_TURNS if isinstance(seen, RigidDriftObservations) else 1):
        about = seen
        if isinstance(seen, RigidDriftObservations):
            about = seen.with_kicks_at(model.positions(found.values))
        found = fit(model, about, started_from(problem.parameters, found), options=options)
    return found


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
        return {"nodal": skinning_weights(moving, basis, options.weights).nodal_values}

    return convex_twin(problem.twin, field, NodalWeights(mesh, run.stages.run("convex_basis", compute)["nodal"]))


def _predicted(run: RefinementRun, twin: Twin) -> WeightField:
    """The network's weights in the frame of the body at rest: its origin is the centre of the bounding box."""
    from inference.predictor import predict

    found = predict(run.capture.folder, checkpoint=run.options.checkpoint, device=run.options.device)
    assert isinstance(found.skinning_field, PredictedField)
    vertices = twin.surface[0]
    return predicted_weights(found.skinning_field, origin=0.5 * (vertices.min(0) + vertices.max(0)))


def _nearest(run: RefinementRun, level: Problem, start: Fit, candidates: Sequence[np.ndarray]) -> Fit:
    """The start with the values that come nearest to the coarse images."""
    misfits = run.workers.map(partial(_misfit, level), candidates)
    if not np.isfinite(misfits).any():
        raise ConvergenceError("convex twin: the body cannot be simulated at any start")
    return replace(start, values=candidates[int(np.argmin(misfits))])


def _misfit(level: Problem, values: np.ndarray) -> float:
    try:
        return misfit_of(level.seen, level.reduced().positions(values))
    except ConvergenceError:
        return np.inf


def _photometric(run: RefinementRun, cameras: tuple[Camera, ...], drawn: ConvexField, pixels: int) -> Observed:
    """The videos at a scale at which the object is that many pixels across."""
    capture, parts, sources = run.capture, [], []
    for camera in cameras:
        frames, masks = capture.video(camera.name).frames[: capture.observed_frames], capture.mask(camera.name)
        assert masks is not None
        across = int(np.ptp(np.argwhere(masks[0]), axis=0).max()) + 1
        part = PhotometricObservations.of_video(
            camera, frames, masks[: len(frames)], drawn, scale=min(1.0, pixels / across), exposure=run.options.exposure
        )
        parts.append(part)
        sources.append(f"camera {camera.name}: {len(part.frames) // 3} pixels")
    return Observed(StackedObservations.of(parts), tuple(sources), cameras)
