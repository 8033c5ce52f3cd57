"""Roll-out of a reduced scene in time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Float
from torch import Tensor

from physconvex.contact import Friction
from physconvex.errors import ConvergenceError
from physconvex.fem.simulation import SolveStatistics
from physconvex.integrators import (
    IntegratorName,
    Minimum,
    State,
    StepCoefficients,
    bdf2,
    check_stepping,
    extrapolate,
    frame_states,
    implicit_euler,
    minimise,
)
from physconvex.reduced.equations import StepEquations
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.space import ReducedSpace
from physconvex.reduced.world_equations import WorldEquations

__all__ = ["ReducedTrajectory", "SolvedPass", "StepRecord", "Stepper", "simulate"]

_MAX_HALVINGS = 8
_STALE_RATE = 0.5  # secants make up for a factor that has grown old


@dataclass(frozen=True)
class ReducedTrajectory:
    """States at the frames.

    Attributes:
        space: the reduced space the coordinates belong to.
        times: [s], shape [T].
        coordinates: y [m], shape [T, R, 3].
        velocities: ẏ [m/s], shape [T, R, 3].
        statistics: what the roll-out cost.
        flowed: F_f at the interior samples, shape [T, Q, 3, 3]; None for an elastic body.
    """

    space: ReducedSpace
    times: Float[np.ndarray, " T"]
    coordinates: Float[np.ndarray, "T R 3"]
    velocities: Float[np.ndarray, "T R 3"]
    statistics: SolveStatistics
    flowed: Float[np.ndarray, "T Q 3 3"] | None = None

    def positions(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "T P 3"]:
        """Where material points, given by their rest positions [m], are at the frames [m]."""
        return self.space.shape_values(points) @ self.coordinates

    def point_velocities(self, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "T P 3"]:
        """Their velocities [m/s]."""
        return self.space.shape_values(points) @ self.velocities

    def handles(self) -> Float[np.ndarray, "T K 3 4"]:
        """Z_m(t) of φ(X) = X + Σ_m W_m(X) Z_m [X; 1], the constant weight first; zero at rest."""
        return self.space.handles(self.coordinates)


@dataclass(frozen=True)
class SolvedPass:
    """One solve of a time step: its solution `x` [m] and the friction that was frozen during it."""

    x: Float[np.ndarray, "R 3"]
    friction: tuple[Friction, ...]


@dataclass(frozen=True)
class StepRecord:
    """Everything a converged time step was made of.

    Attributes:
        before: state at its start.
        history: the state one equal step before that, if there is one; it enters the first guess.
        two_step: whether the step was BDF2 (which needs a history), else implicit Euler.
        step: h [s].
        coefficients: of the incremental potential.
        viscous: F* the viscosity was frozen at.
        passes: one solve per linearisation of friction.
        after: state at its end.
    """

    before: State
    history: State | None
    two_step: bool
    step: float
    coefficients: StepCoefficients
    viscous: Tensor | None
    passes: tuple[SolvedPass, ...]
    after: State


Observer = Callable[[StepEquations, StepRecord], None]
Equations = TypeVar("Equations", StepEquations, WorldEquations)


class Stepper(Generic[Equations]):
    """Advances a state; a step that does not converge is cut in two.

    Args:
        equations: of the steps.
        integrator, friction_passes: see `simulate`.
        tolerance: Newton's last step [m].
        observer: called with the equations and the record of every converged step.
    """

    def __init__(
        self,
        equations: Equations,
        integrator: IntegratorName,
        tolerance: float,
        friction_passes: int,
        observer: Callable[[Equations, StepRecord], None] | None = None,
    ) -> None:
        self.integrator, self.friction_passes, self.tolerance = integrator, friction_passes, tolerance
        self.observer: Callable[[Equations, StepRecord], None] | None = observer
        self.equations: Equations = equations
        self.previous: State | None = None
        self.previous_step = np.nan
        self.steps = self.iterations = self.halved = self.projections = 0

    def advance(self, state: State, step: float, depth: int = 0) -> State:
        try:
            record = self._try(state, step)
        except ConvergenceError as error:
            if depth == _MAX_HALVINGS:
                raise ConvergenceError(
                    f"time step at t = {state.time:.6g} s failed even at h = {step:.3e} s: {error}"
                ) from error
            self.halved += 1
            self.previous, self.equations.factorised = None, False
            middle = self.advance(state, step / 2, depth + 1)
            return self.advance(middle, step / 2, depth + 1)
        self.previous, self.previous_step = state, step
        self.equations.commit(record.after.positions)
        if self.observer is not None:
            self.observer(self.equations, record)
        return record.after

    def _try(self, state: State, step: float) -> StepRecord:
        history = self.previous if math.isclose(self.previous_step, step, rel_tol=1e-9) else None
        guess = extrapolate(state, history, step)
        two_step = self.integrator == "bdf2" and history is not None
        coefficients = bdf2(state, history, step) if two_step and history else implicit_euler(state, step)
        self.equations.set_step(coefficients, state.time + step, guess, state)
        passes = [self._minimise(guess)]
        while len(passes) < self.friction_passes and self.equations.freeze_friction(passes[-1].x):
            passes.append(self._minimise(passes[-1].x))
            if self.equations.settled(passes[-1].x - passes[-2].x, step):
                break
        x = passes[-1].x
        if not np.isfinite(x).all():
            raise ConvergenceError("the new state is not finite")
        self.steps += 1
        after = State(state.time + step, x, coefficients.velocity(x))
        return StepRecord(state, history, two_step, step, coefficients, self.equations.viscous, tuple(passes), after)

    def _minimise(self, start: np.ndarray) -> SolvedPass:
        found: Minimum = minimise(self.equations, start, tolerance=self.tolerance, stale_rate=_STALE_RATE)
        self.iterations += found.iterations
        self.projections += found.projections
        return SolvedPass(found.x, self.equations.friction)

    def statistics(self) -> SolveStatistics:
        return SolveStatistics(
            steps=self.steps,
            newton_iterations=self.iterations,
            factorisations=self.equations.factorisations,
            halved_steps=self.halved,
            projections=self.projections,
        )


def simulate(
    scene: ReducedScene,
    *,
    frames: int = 24,
    fps: float = 24.0,
    steps_per_frame: int = 16,
    integrator: IntegratorName = "bdf2",
    tolerance: float = 3e-8,
    friction_passes: int = 12,
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
        observer: called with the equations and the record of every converged step.
        on_frame: called with the number of every finished frame.

    Raises:
        InputError: an argument out of range.
        ConvergenceError: a step failed even after eight halvings.
    """
    check_stepping(frames, fps, steps_per_frame, integrator, friction_passes)
    size = scene.body.space.samples.size
    stepper = Stepper(StepEquations(scene), integrator, tolerance * size, friction_passes, observer)
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
