"""Rigid drift after a contact: its likely size, and the report of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from pydantic import JsonValue

from inference.refinement.motion import RefinedMotion, shown
from inference.refinement.problem import Problem
from inference.refinement.stages import RefinementRun
from physconvex import ConvergenceError
from physconvex.dynamics import simulate
from physconvex.identify import (
    Fit,
    FullModel,
    RigidDriftObservations,
    first_contact,
    likely_drift,
    model_drift,
    roll_out_together,
)
from physconvex.mesh import Embedding
from physconvex.numerics import best_rotation

_LIMIT = 2.0  # times the difference of two meshes
_TOLD = 0.01  # of the size: least drift that is reported to the user


@dataclass(frozen=True, eq=False)
class RigidDrift:
    """Rigid drift of the recording from the model.

    Attributes:
        first_frame: of the first contact.
        sigma: standard deviation of the change of velocity in each frame [m/s].
        rms: distance by frame [m], shape [T].
        size: of the body [m].
    """

    first_frame: int
    sigma: float
    rms: Float[np.ndarray, " T"]
    size: float

    def to_json(self) -> dict[str, JsonValue]:
        """For `refinement.json`."""
        return {"first_frame": self.first_frame, "sigma_m_per_s": self.sigma, "rms_m": [float(r) for r in self.rms]}

    def sentences(self) -> tuple[str, ...]:
        """Notes for the user."""
        share = float(self.rms.max()) / self.size
        if share < _TOLD:
            return ()
        return (
            f"From the contact by frame {self.first_frame} on the recording drifts from the model as a rigid body, by "
            f"{100 * share:.0f} % of its size at most; the estimates rest on what is left. Contact points, friction "
            "or the initial motion may be other than stated.",
        )


def with_drift_limit(run: RefinementRun, problem: Problem, model: FullModel, other: FullModel, found: Fit) -> Problem:
    """The problem with the largest drift that it may have: that between two meshes of a body that hits something.

    Args:
        run: the refinement.
        problem: the fit's problem.
        model, other: on different meshes; both are run at a fit's values.
        found: the fit.
    """
    if not problem.twin.may_strike:
        return problem
    points = problem.twin.mesh.vertices if problem.surface is None else problem.surface.points

    def compute() -> dict[str, np.ndarray]:
        roll_out_together((m, found.values) for m in (model, other))
        one, another = (replace(m, points=points).positions(found.values) for m in (model, other))
        scene, interval = problem.twin.scene, 1 / problem.twin.fps
        begin = first_contact(one, scene.obstacles, interval * np.arange(len(one)), scene.gravity)
        if begin is None or begin >= len(one):
            return {"limit": np.zeros(0)}
        return {"limit": np.array([begin, _LIMIT * model_drift(one, another, begin, interval)])}

    limit = run.stages.run("drift_limit", compute)["limit"]
    return replace(problem, drift_limit=(int(limit[0]), float(limit[1])) if len(limit) else None)


def with_drift_by(run: RefinementRun, problem: Problem, model: FullModel, found: Fit, name: str) -> Problem:
    """The problem with the most likely drift for a model's positions at a fit's values.

    Args:
        run: the refinement.
        problem: a drift that it already has is ignored.
        model: of the observed points.
        found: the fit.
        name: of the stage.
    """
    plain = replace(problem, drift=0.0)
    if problem.drift_limit is None:
        return plain
    begin, most = problem.drift_limit

    def compute() -> dict[str, np.ndarray]:
        at = model.begun(found.values)
        likely = likely_drift(plain.undrifted, at, begin, 1 / plain.twin.fps, most=most, workers=run.workers)
        return {"sigma": np.array(0.0 if likely is None else likely.sigma)}

    return replace(plain, drift=float(run.stages.run(name, compute)["sigma"]))


def with_drift(run: RefinementRun, problem: Problem, found: Fit, name: str) -> Problem:
    """The same by the problem's full model; the problem as it is if that fails: the next search reports it."""
    try:
        return with_drift_by(run, problem, problem.full(run.memory), found, name)
    except ConvergenceError:
        return problem


def drift_of(problem: Problem, found: Fit) -> RigidDrift | None:
    """The drift of a fit; None where there is none."""
    seen = problem.seen
    if not isinstance(seen, RigidDriftObservations):
        return None
    moved = np.linalg.norm(seen.drift(found.positions), axis=-1)
    return RigidDrift(seen.begin, seen.sigma, np.sqrt(np.square(moved).mean(axis=1)), problem.twin.mesh.size)


def drifted(problem: Problem, found: Fit) -> Float[np.ndarray, "T P 3"]:
    """Positions of the points in the fit, with rigid drift [m]."""
    seen = problem.seen
    drift = seen.drift(found.positions) if isinstance(seen, RigidDriftObservations) else 0.0
    return np.asarray(found.positions + drift)


def followed_motion(
    run: RefinementRun, problem: Problem, full: FullModel, found: Fit, motion: RefinedMotion
) -> RefinedMotion:
    """The motion with the rigid drift added, as in the recording.

    Beyond the observed frames the full model goes on from the state in which the recording leaves the body; if that
    fails, or with the reduced model, the drift goes on as it is.

    Args:
        run: the refinement.
        problem: the fit's problem.
        full: the full model, on any mesh.
        found: the fit.
        motion: of the fit.
    """
    seen = problem.seen
    if not isinstance(seen, RigidDriftObservations):
        return motion
    embedding, observed = Embedding.of_points(motion.mesh, seen.points), problem.frames
    nodes = seen.carried(embedding.apply(motion.nodes), motion.nodes)
    if motion.model == "full" and observed < len(nodes):
        past = motion.nodes[:observed]
        drift = seen.drift_velocity(embedding.apply(past), past)
        model = replace(full, mesh=motion.mesh)

        def compute() -> dict[str, np.ndarray]:
            return {"nodes": _continued(model, found.values, nodes[observed - 1], drift, len(nodes) - observed + 1)}

        try:
            nodes = np.concatenate([nodes[:observed], run.stages.run("followed", compute)["nodes"][1:]])
        except ConvergenceError as error:
            run.warnings.append(f"Beyond the observed frames the followed motion drifts on without a model: {error}.")
    vertices, markers = shown(run.capture, full.twin, motion.mesh, nodes)
    return replace(motion, nodes=nodes, vertices=vertices, markers=markers)


def _continued(
    model: FullModel, values: np.ndarray, nodes: Float[np.ndarray, "V 3"], drift: Float[np.ndarray, "V 3"], frames: int
) -> Float[np.ndarray, "T V 3"]:
    """Positions of the nodes [m] from the last frame of a model on, its state moved rigidly to where it is seen.

    A drift may put the body into an obstacle, where no body is: it is moved out, as deep as the model itself is in.

    Args:
        model: its last frame is the one.
        values: of its parameters.
        nodes: seen in that frame [m].
        drift: velocity of the nodes beside the model's [m/s].
        frames: that one included.
    """
    case = model.roll_out(values)
    run = simulate(case.scene, case.timing)
    last, velocities = run.positions[-1], run.velocities[-1]
    turn = best_rotation(last, nodes)
    moved = nodes.mean(axis=0) + (last - last.mean(axis=0)) @ turn.T
    for obstacle in case.scene.obstacles:
        gaps, least = obstacle.gap(moved, 0.0), min(0.0, float(obstacle.gap(last, 0.0).min()))
        deepest = int(np.argmin(gaps))
        moved = moved + max(0.0, least - gaps[deepest]) * obstacle.normals(moved, 0.0)[deepest]
    scene = replace(
        case.scene,
        initial_orientation=(0.0, 0.0, 0.0),
        initial_positions=moved,
        initial_velocities=velocities @ turn.T + drift,
    )
    return simulate(scene, replace(case.timing, frames=frames)).positions
