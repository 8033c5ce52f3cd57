"""Time steps one after the other, for every simulator that minimises an incremental potential."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from physconvex.dynamics.contact import Friction
from physconvex.dynamics.integrators import (
    GuessErrors,
    Minimum,
    Objective,
    State,
    StepCoefficients,
    extrapolate,
    minimise,
    step_coefficients,
)
from physconvex.dynamics.timing import Timing
from physconvex.errors import ConvergenceError

MAX_HALVINGS = 8
_REMEMBERED = 64  # states: most doublings of the step at once
_ENERGY_HALVINGS = 4  # most halvings of a step that gains energy


@dataclass(frozen=True)
class SolveStatistics:
    """Cost of a roll-out.

    Attributes:
        steps: time steps.
        newton_iterations: of all steps.
        factorisations: of Newton's matrix.
        halved_steps: halved steps, which fail to converge or gain energy.
        projections: matrices that are not positive definite and are projected: the body is near buckling.
    """

    steps: int = 0
    newton_iterations: int = 0
    factorisations: int = 0
    halved_steps: int = 0
    projections: int = 0


@dataclass(frozen=True)
class SolvedPass:
    """One solve of a time step: its solution `x` [m], shape [R, 3], and its frozen friction."""

    x: np.ndarray
    friction: tuple[Friction, ...]


@dataclass(frozen=True)
class StepRecord:
    """All data of a converged time step.

    Attributes:
        before: state at its start.
        history: the state one equal step before that, if there is one; the first guess uses it.
        two_step: whether the step was BDF2 (which needs a history), else implicit Euler.
        step: h [s].
        coefficients: of the incremental potential.
        passes: one solve per linearisation of friction.
        after: state at its end.
    """

    before: State
    history: State | None
    two_step: bool
    step: float
    coefficients: StepCoefficients
    passes: tuple[SolvedPass, ...]
    after: State


@runtime_checkable
class StepObjective(Objective, Protocol):
    """The incremental potential of one time step, and what is fixed during it."""

    friction: tuple[Friction, ...]

    @property
    def factorisations(self) -> int:
        """Number of factorisations of Newton's matrix."""

    def first_guess(self, guess: np.ndarray, time: float) -> np.ndarray:
        """Start of Newton's method [m], from the extrapolation to the time [s] at the step's end."""

    def set_step(self, coefficients: StepCoefficients, time: float, guess: np.ndarray, last: State) -> None:
        """Fix everything that is constant during one time step that ends at `time` [s]."""

    def freeze_friction(self, x: np.ndarray) -> bool:
        """Update frozen terms of a solve at x; returns whether there are any."""

    def settled(self, change: np.ndarray, step: float) -> bool:
        """Whether a change [m] between two solves of a step of that many seconds is too small for another solve."""

    def commit(self, x: np.ndarray) -> None:
        """Store the flow at the end of a step at x."""

    def flowed(self) -> tuple[np.ndarray | None, ...]:
        """Current F_f of each body's samples; None without flow, or if it is not requested."""


Observer = Callable[[Any, StepRecord], None]  # called with the equations and the record of every converged step


def _between(first: State, second: State, time: float) -> State:
    """The state at a time [s] between two states."""
    span = second.time - first.time
    t, rise = (time - first.time) / span, (second.positions - first.positions) / span
    bend, twist = rise - first.velocities, first.velocities + second.velocities - 2 * rise
    positions = first.positions + span * t * (first.velocities + t * (bend + (t - 1) * twist))
    return State(time, positions, first.velocities + t * (2 * bend + (3 * t - 2) * twist))


@dataclass(frozen=True, eq=False)
class PreparedRollOut:
    """A scene prepared for its roll-out.

    Attributes:
        equations: of its time steps.
        start: its state at t = 0.
        tolerance: Newton's last step [m].
        stale_rate: contraction of Newton's steps above which a reused factorisation is renewed.
        steps_per_frame: time steps of a frame, or a function of the state at its start.
        solve: finds the positions at the end of a step from a first guess, instead of passes.
        energy: total energy [J] of a state without external work; None: energies are not checked.
        energy_tolerance: gain [J] above which a step is halved.
    """

    equations: StepObjective
    start: State
    tolerance: float
    stale_rate: float
    steps_per_frame: int | Callable[[State], int]
    solve: Callable[[np.ndarray], Minimum] | None = None
    energy: Callable[[State], float] | None = None
    energy_tolerance: float = float("inf")


class Stepper:
    """Advances a state; a step that does not converge is halved.

    Args:
        prepared: equations of the steps, and their tolerances. A step that raises the energy by more than its tolerance
            is halved as well, at most four times: BDF2 overshoots at impacts shorter than a step.
        timing: integrator ("bdf2": implicit Euler in the first step and the first after a halving) and friction passes.
        observer: called with the equations and the record of every converged step.
        guess_errors: of a similar roll-out; they correct the first guesses.
        recorded_errors: receives the errors of this roll-out's first guesses.
    """

    def __init__(
        self,
        prepared: PreparedRollOut,
        timing: Timing,
        *,
        observer: Observer | None = None,
        guess_errors: GuessErrors | None = None,
        recorded_errors: GuessErrors | None = None,
    ) -> None:
        self.prepared, self.timing, self.equations = prepared, timing, prepared.equations
        self.observer, self.guess_errors, self.recorded_errors = observer, guess_errors, recorded_errors
        self._known_energy: tuple[State, float] | None = None
        self.recent: deque[State] = deque(maxlen=_REMEMBERED)  # at the starts of the last steps
        self.steps = self.iterations = self.halved = self.projections = 0

    def advance(self, state: State, step: float, depth: int = 0) -> State:
        """The state one step [s] later.

        Raises:
            ConvergenceError: it fails even after eight halvings.
        """
        try:
            record = self._try(state, step)
            if self.prepared.energy is not None and depth < _ENERGY_HALVINGS:
                self._check_energy(self.prepared.energy, record)
        except ConvergenceError as error:
            if depth == MAX_HALVINGS:
                raise ConvergenceError(
                    f"time step at t = {state.time:.6g} s failed even at h = {step:.3e} s: {error}"
                ) from error
            self.halved += 1
            self.recent.clear()
            self.equations.factorised = False
            middle = self.advance(state, step / 2, depth + 1)
            return self.advance(middle, step / 2, depth + 1)
        self.steps += 1
        self.recent.append(state)
        self.equations.commit(record.after.positions)
        if self.observer is not None:
            self.observer(self.equations, record)
        return record.after

    def _try(self, state: State, step: float) -> StepRecord:
        time = state.time + step
        history = self._history(state, step)
        guess = self.equations.first_guess(extrapolate(state, history, step), time)
        two_step = self.timing.integrator == "bdf2" and history is not None
        coefficients = step_coefficients(state, history if two_step else None, step)
        self.equations.set_step(coefficients, time, guess, state)
        begin = guess if self.guess_errors is None else self.guess_errors.corrected(guess, time, step)
        if self.prepared.solve is None:
            passes = self._passes(begin, lambda: self.equations.first_guess(state.positions.copy(), time), step)
        else:
            passes = self._solved_at_once(self.prepared.solve, begin)
        x = passes[-1].x
        if not np.isfinite(x).all():
            raise ConvergenceError("the new state is not finite")
        if self.recorded_errors is not None:
            self.recorded_errors.note(time, step, x - guess)
        after = State(time, x, coefficients.velocity(x))
        return StepRecord(state, history, two_step, step, coefficients, tuple(passes), after)

    def _history(self, state: State, step: float) -> State | None:
        """The state one step [s] earlier, by Hermite's cubic between two known states. None if none is so old.

        With an observer, only the last two states themselves are used.
        """
        time, later = state.time - step, state
        for earlier in reversed(self.recent):
            if math.isclose(earlier.time, time, rel_tol=0.0, abs_tol=1e-6 * step):
                return earlier
            if self.observer is not None:
                break
            if earlier.time < time:
                return _between(earlier, later, time)
            later = earlier
        return None

    def _passes(self, guess: np.ndarray, last: Callable[[], np.ndarray], step: float) -> list[SolvedPass]:
        passes = [self._minimise(guess, fallback=last)]
        while len(passes) < self.timing.friction_passes and self.equations.freeze_friction(passes[-1].x):
            passes.append(self._minimise(passes[-1].x))
            if self.equations.settled(passes[-1].x - passes[-2].x, step):
                break
        return passes

    def _solved_at_once(self, solve: Callable[[np.ndarray], Minimum], guess: np.ndarray) -> list[SolvedPass]:
        """The solution; for an observer, with its friction."""
        found = solve(guess)
        if self.observer is not None:
            self.equations.freeze_friction(found.x)
        return [self._counted(found)]

    def _check_energy(self, energy: Callable[[State], float], record: StepRecord) -> None:
        known = self._known_energy
        before = known[1] if known is not None and known[0] is record.before else energy(record.before)
        after = energy(record.after)
        if after > before + self.prepared.energy_tolerance:
            raise ConvergenceError(f"the energy rose by {after - before:.3g} J")
        self._known_energy = record.after, after

    def _minimise(self, start: np.ndarray, fallback: Callable[[], np.ndarray] | None = None) -> SolvedPass:
        tolerance, stale_rate = self.prepared.tolerance, self.prepared.stale_rate
        found = minimise(self.equations, start, tolerance=tolerance, stale_rate=stale_rate, fallback=fallback)
        return self._counted(found)

    def _counted(self, found: Minimum) -> SolvedPass:
        self.iterations += found.iterations
        self.projections += found.projections
        return SolvedPass(found.x, self.equations.friction)

    def statistics(self) -> SolveStatistics:
        """Cost of the steps so far."""
        return SolveStatistics(
            steps=self.steps,
            newton_iterations=self.iterations,
            factorisations=self.equations.factorisations,
            halved_steps=self.halved,
            projections=self.projections,
        )
