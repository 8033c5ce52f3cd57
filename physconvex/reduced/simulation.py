"""Roll-out of a reduced scene in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import (
    IntegratorName,
    SolveStatistics,
    State,
    Stepper,
    StepRecord,
    check_stepping,
    frame_states,
)
from physconvex.numerics import one_torch_thread
from physconvex.reduced.equations import StepEquations
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.space import ReducedSpace

__all__ = ["STALE_RATE", "ReducedTrajectory", "simulate"]

STALE_RATE = 0.5  # secants make up for a factor that has grown old


@dataclass(frozen=True)
class ReducedTrajectory:
    """States at the frames.

    Attributes:
        space: the reduced space the coordinates belong to.
        times: [s], shape [T].
        coordinates: y [m], shape [T, R, 3].
        velocities: ẏ [m/s], shape [T, R, 3].
        statistics: what the roll-out cost.
        flowed: F_f at the interior samples, shape [T, Q, 3, 3], of `Flows` [T, Q, 2, 3, 3]; None for
            an elastic body.
    """

    space: ReducedSpace
    times: Float[np.ndarray, " T"]
    coordinates: Float[np.ndarray, "T R 3"]
    velocities: Float[np.ndarray, "T R 3"]
    statistics: SolveStatistics
    flowed: Float[np.ndarray, "T Q *K 3 3"] | None = None

    def positions(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "T P 3"]:
        """Where material points, given by their rest positions [m], are at the frames [m]."""
        return self.space.shape_values(points) @ self.coordinates

    def point_velocities(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "T P 3"]:
        """Their velocities [m/s]."""
        return self.space.shape_values(points) @ self.velocities

    def handles(self) -> Float[np.ndarray, "T K 3 4"]:
        """Z_m(t) of φ(X) = X + Σ_m W_m(X) Z_m [X; 1], the constant weight first; zero at rest."""
        return self.space.handles(self.coordinates)


Observer = Callable[[StepEquations, StepRecord], None]


@one_torch_thread()
def simulate(
    scene: ReducedScene,
    *,
    frames: int = 24,
    fps: float = 24.0,
    steps_per_frame: int = 16,
    integrator: IntegratorName = "bdf2",
    tolerance: float = 3e-8,
    friction_passes: int = 12,
    energy_tolerance: float | None = None,
    observer: Observer | None = None,
    on_frame: Callable[[int], None] | None = None,
) -> ReducedTrajectory:
    """Roll a reduced scene out in time.

    Args:
        scene: body, forces, initial state.
        frames: number of states to return, the first at t = 0.
        fps: frames per second [1/s].
        steps_per_frame: time steps between frames.
        integrator: "bdf2" (second order, first step implicit Euler) or "implicit_euler".
        tolerance: Newton's last step, relative to the body's size.
        friction_passes: how often friction is linearised and solved in each step at most, and the pressure in sand
            taken; fewer are made where the surface's velocities no longer change by more than the scene's
            `slip_velocity`. The full model's rule, see docs/decisions/001-frozen-friction.md.
        energy_tolerance: steps that raise the energy of an autonomous scene by more than this share of its
            `energy_scale` are cut in two; None: not. Impacts that take less than a step gain up to some hundredths
            without. Derivatives by parameters jump where the number of cut steps changes.
        observer: called with the equations and the record of every converged step.
        on_frame: called with the number of every finished frame.

    Raises:
        InputError: an argument out of range.
        ConvergenceError: a step failed even after eight halvings.
    """
    check_stepping(frames, fps, steps_per_frame, integrator, friction_passes, energy_tolerance)
    size = scene.body.space.samples.size
    equations = StepEquations(scene)
    guarded = energy_tolerance is not None and scene.autonomous
    stepper = Stepper(
        equations,
        integrator,
        tolerance * size,
        friction_passes,
        stale_rate=STALE_RATE,
        observer=observer,
        energy=equations.energy if guarded else None,
        energy_tolerance=(energy_tolerance or 0.0) * scene.energy_scale,
    )
    start = State(0.0, scene.start.copy(), scene.start_velocities())
    states, flows = [], []
    for state in frame_states(stepper.advance, start, frames=frames, fps=fps, steps_per_frame=steps_per_frame):
        states.append(state)
        flows.append(stepper.equations.flowed())
        if on_frame is not None and state is not start:
            on_frame(len(states) - 1)
    return ReducedTrajectory(
        space=scene.body.space,
        times=np.array([s.time for s in states]),
        coordinates=np.stack([s.positions for s in states]),
        velocities=np.stack([s.velocities for s in states]),
        statistics=stepper.statistics(),
        flowed=None if scene.body.flow is None else np.stack([f for f in flows if f is not None]),
    )
