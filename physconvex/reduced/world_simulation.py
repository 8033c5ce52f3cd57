"""Roll-out of several bodies in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import IntegratorName, SolveStatistics, State, Stepper, check_stepping, frame_states
from physconvex.numerics import one_torch_thread
from physconvex.reduced.simulation import STALE_RATE, ReducedTrajectory
from physconvex.reduced.world import ReducedWorld
from physconvex.reduced.world_equations import WorldEquations

__all__ = ["WorldTrajectory", "simulate_world"]


@dataclass(frozen=True)
class WorldTrajectory:
    """States of several bodies at the frames.

    Attributes:
        times: [s], shape [T].
        bodies: the trajectory of each; their statistics are those of the whole.
        statistics: what the roll-out cost.
    """

    times: Float[np.ndarray, " T"]
    bodies: tuple[ReducedTrajectory, ...]
    statistics: SolveStatistics


@one_torch_thread()
def simulate_world(
    world: ReducedWorld,
    *,
    frames: int = 24,
    fps: float = 24.0,
    steps_per_frame: int = 16,
    integrator: IntegratorName = "bdf2",
    tolerance: float = 3e-8,
    friction_passes: int = 12,
    energy_tolerance: float | None = None,
    on_frame: Callable[[int], None] | None = None,
) -> WorldTrajectory:
    """Roll several bodies out in time; every step is one Newton solve over the coordinates of all of them.

    Bodies may not cross each other within one step: v h must stay well below their thickness.

    Args:
        world: the bodies, their obstacles and forces.
        frames, fps, steps_per_frame, integrator, friction_passes, energy_tolerance, on_frame: as in `simulate`.
        tolerance: Newton's last step, relative to the smallest body's size.

    Raises:
        InputError: an argument out of range.
        ConvergenceError: a step failed even after eight halvings.
    """
    check_stepping(frames, fps, steps_per_frame, integrator, friction_passes, energy_tolerance)
    equations = WorldEquations(world)
    guarded = energy_tolerance is not None and all(scene.autonomous for scene in world.scenes)
    stepper = Stepper(
        equations,
        integrator,
        tolerance * world.size,
        friction_passes,
        stale_rate=STALE_RATE,
        energy=equations.energy if guarded else None,
        energy_tolerance=(energy_tolerance or 0.0) * sum(scene.energy_scale for scene in world.scenes),
    )
    places = np.concatenate([scene.start for scene in world.scenes])
    start = State(0.0, places, np.concatenate([scene.start_velocities() for scene in world.scenes]))
    states, flows = [], []
    for state in frame_states(stepper.advance, start, frames=frames, fps=fps, steps_per_frame=steps_per_frame):
        states.append(state)
        flows.append(_flowed(stepper.equations))
        if on_frame is not None and state is not start:
            on_frame(len(states) - 1)
    return _gathered(world, states, flows, stepper.statistics())


def _flowed(equations: WorldEquations) -> list[np.ndarray | None]:
    return [body.flowed() for body in equations.bodies]


def _gathered(
    world: ReducedWorld, states: list[State], flows: list[list[np.ndarray | None]], statistics: SolveStatistics
) -> WorldTrajectory:
    times = np.array([state.time for state in states])
    positions, velocities = (np.stack([getattr(s, name) for s in states]) for name in ("positions", "velocities"))
    bodies = tuple(
        ReducedTrajectory(
            scene.body.space,
            times,
            positions[:, where],
            velocities[:, where],
            statistics,
            None if scene.body.flow is None else np.stack([f for f in (row[k] for row in flows) if f is not None]),
        )
        for k, (scene, where) in enumerate(zip(world.scenes, world.slices, strict=True))
    )
    return WorldTrajectory(times, bodies, statistics)
