"""Rigid drift after a contact: how much of it there is likely to be, and what is told of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from inference.refining.problem import Problem
from inference.refining.result import RefinedMotion, RigidDrift
from inference.refining.stages import Stages
from physconvex.fem import Embedding
from physconvex.identify import DriftingObservations, Fit, FullModel, first_contact, likely_drift

__all__ = ["drift_of", "followed_motion", "with_drift"]


def with_drift(problem: Problem, model: FullModel, found: Fit, stages: Stages, name: str) -> Problem:
    """The problem with the drift that is likely where a model is that has been run at a fit's values.

    Args:
        problem: a drift that it has is forgotten.
        model: of the observed points.
        found: the fit.
        stages: the answer is kept there.
        name: of the stage.
    """
    plain = replace(problem, drift=None)
    if (problem.surface is None and not problem.twin.scene.obstacles) or problem.twin.clamp is not None:
        return plain

    def compute() -> dict[str, np.ndarray]:
        begin = _first_contact(plain, model, found.values)
        likely = None
        if begin is not None:
            at = model.linearise(found.values)[0]  # the search that comes next wants these derivatives too
            likely = likely_drift(plain.undrifted, at, begin, 1 / plain.twin.fps)
        return {"drift": np.zeros(0) if likely is None else np.array([likely.begin, likely.sigma])}

    arrays = stages.run(name, compute)["drift"]
    return replace(plain, drift=(int(arrays[0]), float(arrays[1]))) if len(arrays) else plain


def _first_contact(problem: Problem, model: FullModel, values: np.ndarray) -> int | None:
    points = problem.twin.mesh.vertices if problem.surface is None else problem.surface.points
    moved = replace(model, points=points).positions(values)
    scene = problem.twin.scene
    return first_contact(moved, scene.obstacles, np.arange(len(moved)) / problem.twin.fps, scene.gravity)


def drift_of(problem: Problem, found: Fit) -> RigidDrift | None:
    """The drift of a fit; None where there is none."""
    seen = problem.seen
    if not isinstance(seen, DriftingObservations):
        return None
    moved = np.linalg.norm(seen.drift(found.positions), axis=-1)
    return RigidDrift(seen.begin, seen.sigma, np.sqrt(np.square(moved).mean(axis=1)), problem.twin.mesh.size)


def followed_motion(problem: Problem, motion: RefinedMotion) -> RefinedMotion:
    """The motion with the rigid drift added: where the recording has the body; beyond its end the drift goes on."""
    seen = problem.seen
    if not isinstance(seen, DriftingObservations):
        return motion
    points = Embedding.of_points(motion.mesh, seen.points).apply(motion.nodes)

    def carried(others: np.ndarray) -> np.ndarray:
        return seen.carried(points, others) if others.shape[1] else others

    return replace(
        motion,
        nodes=carried(motion.nodes),
        vertices=carried(motion.vertices),
        markers=carried(motion.markers),
    )
