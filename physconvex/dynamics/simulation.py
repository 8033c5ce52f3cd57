"""Simulation of anything whose time steps are minimisations: finite elements, one reduced body or several.

With derivatives of the states by parameters, if requested, which are carried along step by step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float

from physconvex.dynamics.integrators import GuessErrors, State
from physconvex.dynamics.stepping import Observer, PreparedRollOut, SolveStatistics, Stepper, StepRecord
from physconvex.dynamics.timing import Timing
from physconvex.numerics import one_torch_thread


@dataclass(frozen=True, eq=False)
class FrameStates:
    """Raw result of a roll-out: states at the frames, the flow of each body there, and the cost."""

    states: tuple[State, ...]
    flows: tuple[tuple[np.ndarray | None, ...], ...]
    statistics: SolveStatistics

    @cached_property
    def times(self) -> Float[np.ndarray, " T"]:
        """[s]."""
        return np.array([state.time for state in self.states])

    @cached_property
    def positions(self) -> Float[np.ndarray, "T R 3"]:
        """Positions of all degrees of freedom [m]."""
        return np.stack([state.positions for state in self.states])

    @cached_property
    def velocities(self) -> Float[np.ndarray, "T R 3"]:
        """Velocities of all degrees of freedom [m/s]."""
        return np.stack([state.velocities for state in self.states])

    def flowed(self, body: int = 0) -> np.ndarray | None:
        """F_f at the samples of a body at the frames; None for an elastic one."""
        found = [flow for flow in (flows[body] for flows in self.flows) if flow is not None]
        return np.stack(found) if found else None


Trajectory_co = TypeVar("Trajectory_co", covariant=True)
TrajectoryT = TypeVar("TrajectoryT")


@runtime_checkable
class Simulated(Protocol[Trajectory_co]):
    """A scene as `simulate` needs it."""

    def prepared(self, timing: Timing) -> PreparedRollOut:
        """The prepared scene.

        Raises:
            InputError: a setting of the timing that the scene's model does not support.
        """

    def trajectory(self, frames: FrameStates) -> Trajectory_co:
        """The roll-out in the format of the scene's model."""


@one_torch_thread()
def simulate(
    scene: Simulated[TrajectoryT],
    timing: Timing | None = None,
    *,
    observer: Observer | None = None,
    on_frame: Callable[[State], None] | None = None,
    guess_errors: GuessErrors | None = None,
    recorded_errors: GuessErrors | None = None,
) -> TrajectoryT:
    """Roll a scene out in time.

    Several bodies are one scene, and every step is one Newton solve over the coordinates of all of them. Bodies must
    not cross each other within one step: v h must stay well below their thickness.

    Args:
        scene: body (or bodies), forces, initial state.
        timing: frames and time steps; the defaults of `Timing` unless given.
        observer: called with the equations and the record of every converged step.
        on_frame: called with the state at every frame after the first.
        guess_errors: recorded from a roll-out with the same steps and nearly the same parameters; Newton's method then
            needs fewer steps to the same tolerance.
        recorded_errors: receives those of this roll-out, for others; it holds the positions of all steps.

    Returns:
        `physconvex.fem.Trajectory`, `physconvex.reduced.ReducedTrajectory` or `BodiesTrajectory`.

    Raises:
        InputError: an argument out of range, or one that the scene's model does not support.
        ConvergenceError: a step fails even after eight halvings.
    """
    timing = timing or Timing()
    prepared = scene.prepared(timing)
    stepper = Stepper(prepared, timing, observer=observer, guess_errors=guess_errors, recorded_errors=recorded_errors)
    states, flows = [prepared.start], [prepared.equations.flowed()]
    for frame in range(1, timing.frames):
        state, steps = states[-1], prepared.steps_per_frame
        steps = steps(state) if callable(steps) else steps
        for _ in range(steps):
            state = stepper.advance(state, 1.0 / (timing.fps * steps))
        states.append(replace(state, time=frame / timing.fps))
        flows.append(prepared.equations.flowed())
        if on_frame is not None:
            on_frame(states[-1])
    return scene.trajectory(FrameStates(tuple(states), tuple(flows), stepper.statistics()))


@runtime_checkable
class CarriedTangents(Protocol):
    """Derivatives of the state by P parameters."""

    @property
    def state(self) -> State:
        """The derivatives of positions and velocities, of shape [P, R, 3]."""

    def observe(self, equations: Any, record: StepRecord) -> None:
        """Advance over one converged step."""


@runtime_checkable
class Parametrised(Protocol[Trajectory_co]):
    """A scene and the parameters that it is differentiated by."""

    @property
    def scene(self) -> Simulated[Trajectory_co]:
        """The scene at the values."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the P parameters."""

    @property
    def values(self) -> Float[np.ndarray, " P"]:
        """Values of the parameters."""

    def tangents(self, timing: Timing) -> CarriedTangents:
        """The derivatives at the start of a roll-out.

        Raises:
            InputError: unknown parameters, or a scene or timing without derivatives.
        """


@dataclass(frozen=True, eq=False)
class SensitiveTrajectory(Generic[TrajectoryT]):
    """A roll-out and its derivatives.

    Attributes:
        trajectory: the roll-out.
        parameters: names of the parameters.
        values: their values, shape [P].
        coordinate_tangents: derivatives of the positions of nodes (or of reduced coordinates) at the frames, shape
            [T, P, R, 3].
        velocity_tangents: those of the velocities.
    """

    trajectory: TrajectoryT
    parameters: tuple[str, ...]
    values: Float[np.ndarray, " P"]
    coordinate_tangents: Float[np.ndarray, "T P R 3"]
    velocity_tangents: Float[np.ndarray, "T P R 3"]


@one_torch_thread()
def simulate_with_sensitivities(
    parametrised: Parametrised[TrajectoryT], timing: Timing | None = None
) -> SensitiveTrajectory[TrajectoryT]:
    """Roll a scene out and differentiate its states by parameters.

    The step size is not differentiated: with halved steps, the derivative is that of the halved steps.

    Args:
        parametrised: `physconvex.reduced.NamedParameters` or `physconvex.fem.SceneFamily`.
        timing: as in `simulate`.

    Raises:
        InputError: as `simulate`; a scene or timing without derivatives.
        ConvergenceError: as in `simulate`, or the derivatives of a step do not converge.
    """
    timing = timing or Timing()
    carried = parametrised.tangents(timing)
    states = [carried.state]
    run = simulate(
        parametrised.scene, timing, observer=carried.observe, on_frame=lambda _: states.append(carried.state)
    )
    return SensitiveTrajectory(
        trajectory=run,
        parameters=parametrised.names,
        values=parametrised.values,
        coordinate_tangents=np.stack([state.positions for state in states]),
        velocity_tangents=np.stack([state.velocities for state in states]),
    )
