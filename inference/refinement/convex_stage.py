"""The convex twin of a refinement: rendered convexes against all pixels of the videos, coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from inference.refinement.appearance import RestField
from inference.refinement.convex_start import begun
from inference.refinement.observations import Observed
from inference.refinement.problem import Problem, moved_inside, started_from
from inference.refinement.reduced_search import with_free_height, with_predicted_ratio
from inference.refinement.stages import Arrays, RefinementRun
from physconvex import ConvergenceError, InputError
from physconvex.convex import ConvexField
from physconvex.identify import (
    Fit,
    FitOptions,
    PhotometricObservations,
    RigidDriftObservations,
    SecantModel,
    StackedObservations,
    Twin,
    convex_twin,
    fit,
    fit_weights,
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
    problem, found = begun(run, replace(problem, twin=_twin(run, problem, start, rest.field)), start, candidates)
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
