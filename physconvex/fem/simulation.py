"""Roll-out of a scene in time, and its static equilibrium."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import (
    Guide,
    IntegratorName,
    SolveStatistics,
    State,
    Stepper,
    StepRecord,
    check_stepping,
    frame_states,
    minimise,
)
from physconvex.errors import InputError
from physconvex.fem.condensed_contact import CondensedContact
from physconvex.fem.flight_steps import Flight
from physconvex.fem.scene import Scene
from physconvex.fem.step_equations import StepEquations
from physconvex.numerics import one_torch_thread

__all__ = ["ContactSolver", "Trajectory", "simulate", "solve_static"]

ContactSolver = Literal["passes", "condensed"]

_STALE_RATE = 0.25


@dataclass(frozen=True)
class Trajectory:
    """States at the frames: times [T] s, positions [T, V, 3] m, velocities [T, V, 3] m/s, cost, and a guide."""

    times: Float[np.ndarray, " T"]
    positions: Float[np.ndarray, "T V 3"]
    velocities: Float[np.ndarray, "T V 3"]
    statistics: SolveStatistics
    guide: Guide | None = None


Observer = Callable[[StepEquations, StepRecord], None]


@one_torch_thread()
def simulate(
    scene: Scene,
    *,
    frames: int = 24,
    fps: float = 24.0,
    steps_per_frame: int = 16,
    integrator: IntegratorName = "bdf2",
    tolerance: float = 1e-7,
    friction_passes: int = 12,
    contact_solver: ContactSolver = "passes",
    flight_steps_per_frame: int | None = None,
    guide: Guide | None = None,
    keep_guide: bool = False,
    observer: Observer | None = None,
    on_frame: Callable[[State], None] | None = None,
) -> Trajectory:
    """Roll a scene out in time.

    Args:
        scene: body, forces, initial state.
        frames: number of states to return, the first at t = 0.
        fps: frames per second [1/s].
        steps_per_frame: time steps between frames.
        integrator: "bdf2" (second order, first step implicit Euler) or "implicit_euler".
        tolerance: Newton's last step, relative to the body's size.
        friction_passes: how often friction is linearised and solved in each step at most; fewer are made where the
            velocities no longer change by more than the scene's `slip_velocity`. One is explicit in the friction
            weights.
        contact_solver: "passes" minimises with friction frozen, again and again; "condensed" solves for contact and
            friction together on the points that touch (`physconvex.fem.condensed_contact`): nothing is frozen, and
            factors last longer. Where passes converge, both give the same.
        flight_steps_per_frame: time steps in frames after the first in which the body, which has touched no obstacle
            yet, will not come near one; `steps_per_frame` unless given.
        guide: of a roll-out (`Trajectory.guide`) on the same mesh, with the same steps and nearly the same parameters:
            Newton's method then takes fewer steps to the same tolerance.
        keep_guide: whether to return one; it holds the positions of all steps.
        observer: told each converged step and its equations.
        on_frame: told the state at each frame after the first.

    Raises:
        InputError: an argument out of range.
        ConvergenceError: a step failed even after eight halvings.
    """
    check_stepping(frames, fps, steps_per_frame, integrator, friction_passes)
    _check_contact_solver(scene, contact_solver)
    length = tolerance * scene.body.mesh.size
    equations = StepEquations(scene)
    condensed = CondensedContact(equations, length) if contact_solver == "condensed" else None
    noted = Guide() if keep_guide else None
    stepper = Stepper(
        equations,
        integrator,
        length,
        friction_passes,
        stale_rate=_STALE_RATE,
        observer=observer,
        solve=None if condensed is None else condensed.solve,
        guide=guide,
        noted=noted,
    )
    start = State(0.0, scene.start.copy(), scene.start_velocities())
    states = []
    flight = Flight(scene, 1 / fps, steps_per_frame, flight_steps_per_frame or steps_per_frame)
    for state in frame_states(stepper.advance, start, frames=frames, fps=fps, steps_per_frame=flight.steps):
        states.append(state)
        if on_frame is not None and state is not start:
            on_frame(state)
    return Trajectory(
        times=np.array([s.time for s in states]),
        positions=np.stack([s.positions for s in states]),
        velocities=np.stack([s.velocities for s in states]),
        statistics=stepper.statistics(),
        guide=noted,
    )


def _check_contact_solver(scene: Scene, name: str) -> None:
    if name not in get_args(ContactSolver):
        raise InputError(f"contact_solver: got {name!r}; expected one of {', '.join(get_args(ContactSolver))}")
    lagged = scene.body.flow is not None and scene.body.flow.lagged
    only_by_passes = {
        "contact_damping": scene.contact_damping > 0,
        "a flow that takes its pressure from the last pass": lagged,
        "a hanging load": scene.hanging is not None,
    }
    found = [what for what, there in only_by_passes.items() if there]
    if name == "condensed" and found:
        raise InputError(f"contact_solver: got 'condensed' with {' and '.join(found)}; expected 'passes' there")


@one_torch_thread()
def solve_static(scene: Scene, *, tolerance: float = 1e-9, load_steps: int = 1) -> Float[np.ndarray, "V 3"]:
    """Static equilibrium positions [m], shape [V, 3], of a pinned body under its forces.

    Args:
        scene: needs pins or contacts that hold the body; velocities and damping play no role.
        tolerance: Newton's last step, relative to the body's size.
        load_steps: forces are applied in so many equal parts.

    Raises:
        ConvergenceError: Newton's method failed; more load steps may help.
    """
    if load_steps < 1:
        raise InputError(f"load_steps: got {load_steps}; expected at least 1")
    equations = StepEquations(scene)
    x = scene.start.copy()
    if scene.pins is not None:
        x[scene.pins.nodes] = scene.pins.positions(0.0, scene.start)
    total = equations.forces
    for part in range(1, load_steps + 1):
        equations.forces = total * (part / load_steps)
        limit = tolerance * scene.body.mesh.size
        x = minimise(equations, x, tolerance=limit, max_iterations=300, reuse=False).x
    return x
