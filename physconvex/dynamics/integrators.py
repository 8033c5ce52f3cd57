"""Time steps as minimisations, and the Newton method that carries them out.

Implicit Euler and BDF2 both advance M ẍ = f by minimising an incremental potential

    Φ(x) = 1/(2 h̃²) (x − target)ᵀ M (x − target) + V(x) + h̃ D((x − base)/h̃),

where V is the potential of the forces, D the dissipation as a function of velocity, and v = (x − base)/h̃ the new
velocity. Shared by the full-order and the reduced model: both supply an `Objective`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.numerics import NotPositiveDefiniteError

IntegratorName = Literal["bdf2", "implicit_euler"]

_ARMIJO = 1e-4  # sufficient decrease
_STALE_RATE = 0.25  # contraction above which a reused factorisation is renewed
_ROUNDING = 1e-13  # relative error allowed for in energies
_GRAIN = 1e-9  # times closer than this are the same [s]


@dataclass(frozen=True)
class State:
    """Positions [m] and velocities [m/s] of all degrees of freedom at one time [s]."""

    time: float
    positions: np.ndarray
    velocities: np.ndarray


@dataclass(frozen=True)
class StepCoefficients:
    """h̃ [s], `target` [m] and `base` [m] of the incremental potential."""

    step: float
    target: np.ndarray
    base: np.ndarray

    def velocity(self, x: np.ndarray) -> np.ndarray:
        """New velocity [m/s] that belongs to the new positions x [m]."""
        return (x - self.base) / self.step


def implicit_euler(state: State, step: float) -> StepCoefficients:
    """First order: v = (x − x_n)/h, M (v − v_n)/h = f."""
    return StepCoefficients(step, state.positions + step * state.velocities, state.positions)


def bdf2(state: State, previous: State, step: float) -> StepCoefficients:
    """Second order: ẏ ≈ (3 y_{n+1} − 4 y_n + y_{n−1}) / (2h) for positions and velocities; equal steps."""
    short = 2.0 / 3.0 * step
    base = (4.0 * state.positions - previous.positions) / 3.0
    drift = (4.0 * state.velocities - previous.velocities) / 3.0
    return StepCoefficients(short, base + short * drift, base)


def step_coefficients(state: State, previous: State | None, step: float) -> StepCoefficients:
    """BDF2 from the state one equal step before; implicit Euler without such a state."""
    return implicit_euler(state, step) if previous is None else bdf2(state, previous, step)


@runtime_checkable
class Objective(Protocol):
    """A function to minimise, with a linear solver for its (possibly stale) Hessian.

    `rounding` is the size of the rounding errors in its value [J]: large terms may cancel in a small value.
    """

    factorised: bool
    rounding: float

    def evaluate(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Value (may be infinite) and gradient at x."""

    def factorise(self, x: np.ndarray, *, project: bool) -> None:
        """Factorise the Hessian at x; `project` asks for a positive definite approximation.

        Raises:
            NotPositiveDefiniteError: the Hessian is not positive definite.
        """

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Apply the inverse of the last factorised Hessian."""


@dataclass(frozen=True)
class Minimum:
    """Result of `minimise`.

    Attributes:
        x: the point.
        iterations: steps taken.
        last_step: size of the last step (max norm).
        projections: how often the Hessian was not positive definite and was projected.
    """

    x: np.ndarray
    iterations: int
    last_step: float
    projections: int = 0


def _renew(objective: Objective, x: np.ndarray, *, project: bool) -> bool:
    """Factorise at x, projected if requested or necessary; returns whether it is projected."""
    if not project:
        with suppress(NotPositiveDefiniteError):
            objective.factorise(x, project=False)
            return False
    try:
        objective.factorise(x, project=True)
    except NotPositiveDefiniteError as error:
        raise ConvergenceError(
            f"the projected Hessian is singular ({error}): a static body must be held by pins or contacts"
        ) from error
    return True


@dataclass(frozen=True)
class _Trial:
    x: np.ndarray
    value: float
    gradient: np.ndarray


def _line_search(objective: Objective, at: _Trial, direction: np.ndarray, slope: float, halvings: int) -> _Trial | None:
    """Backtracking until the Armijo condition holds; None when it never does."""
    length = 1.0
    allowance = _ROUNDING * (1.0 + abs(at.value)) + objective.rounding
    for _ in range(halvings):
        x = at.x + length * direction
        value, gradient = objective.evaluate(x)
        if np.isfinite(value) and value <= at.value + _ARMIJO * length * slope + allowance:
            return _Trial(x, value, gradient)
        length *= 0.5
    return None


def _careful(tolerance: float, rate: float) -> float:
    """Size of the last step at which a slowly shrinking sequence has the error of one that shrinks fourfold.

    A rate of zero means that it is unknown.
    """
    usual = _STALE_RATE / (1 - _STALE_RATE)
    return min(1.0, usual * (1 / rate - 1) if rate > 0 else usual) * tolerance


def minimise(
    objective: Objective,
    x: np.ndarray,
    *,
    tolerance: float,
    max_iterations: int = 100,
    reuse: bool = True,
    stale_rate: float = _STALE_RATE,
    fallback: Callable[[], np.ndarray] | None = None,
) -> Minimum:
    """Newton's method with line search; the factorisation is kept while it contracts well.

    Args:
        objective: what to minimise.
        x: starting point.
        tolerance: largest component of the last step, in the units of x.
        max_iterations: bound on the number of steps.
        reuse: start with the objective's last factorisation, and keep it while steps shrink fast enough.
        stale_rate: ratio of one step to the preceding one above which a reused factorisation is renewed. If it is above
            1/4, the last step must be smaller than `tolerance`, so that the remaining error is the same.
        fallback: gives another start if the value at x is infinite: an extrapolated state may be turned inside out.

    Raises:
        ConvergenceError: no finite value at the start, no descent possible, or the bound on steps reached.
    """
    at = _Trial(x, *objective.evaluate(x))
    if not np.isfinite(at.value) and fallback is not None:
        x = fallback()
        at = _Trial(x, *objective.evaluate(x))
    if not np.isfinite(at.value):
        raise ConvergenceError(f"the start has no finite energy ({at.value})")
    fresh, projected, projections = False, False, 0
    if not (objective.factorised and reuse):
        projected, fresh = _renew(objective, at.x, project=False), True
        projections += projected
    previous = np.inf
    for iteration in range(1, max_iterations + 1):
        direction = -objective.solve(at.gradient)
        size = float(np.abs(direction).max(initial=0.0))
        if not fresh and size > stale_rate * previous and size > tolerance:
            projected, fresh = _renew(objective, at.x, project=False), True
            projections += projected
            direction = -objective.solve(at.gradient)
            size = float(np.abs(direction).max(initial=0.0))
        slope = float((at.gradient * direction).sum())
        if size <= (tolerance if stale_rate <= _STALE_RATE else _careful(tolerance, size / previous)):
            return Minimum(at.x + direction, iteration, size, projections)
        found = _line_search(objective, at, direction, slope, 12 if fresh else 2) if slope < 0 else None
        if found is not None:
            at, previous, fresh = found, size, not reuse
            if not reuse:
                projected = _renew(objective, at.x, project=False)
                projections += projected
        elif not fresh or not projected:
            projected, fresh = _renew(objective, at.x, project=fresh), True
            projections += projected
            previous = np.inf
        else:
            raise ConvergenceError(f"no descent from a step of size {size:.3e} (iteration {iteration})")
    raise ConvergenceError(f"{max_iterations} iterations left a step of {size:.3e}; asked for {tolerance:.3e}")


def extrapolate(state: State, history: State | None, step: float) -> np.ndarray:
    """First guess of the new coordinates [m], linear in the states."""
    guess = state.positions + step * state.velocities
    return guess if history is None else guess + 0.5 * step * (state.velocities - history.velocities)


class GuessErrors:
    """Errors [m] of the first guesses of one roll-out, indexed by end and length of the step.

    Another roll-out with nearly the same parameters makes nearly the same errors, so that its guesses can be corrected.
    """

    def __init__(self) -> None:
        self._missed: dict[tuple[int, int], np.ndarray] = {}

    def note(self, time: float, step: float, missed: np.ndarray) -> None:
        """Store the error [m] of a step with that end [s] and length [s]."""
        self._missed[_key(time, step)] = missed

    def corrected(self, guess: np.ndarray, time: float, step: float) -> np.ndarray:
        """The first guess [m] of a step, corrected by the recorded error if there is one."""
        missed = self._missed.get(_key(time, step))
        return guess if missed is None else guess + missed

    def __len__(self) -> int:
        """Number of steps."""
        return len(self._missed)


def _key(time: float, step: float) -> tuple[int, int]:
    return round(time / _GRAIN), round(step / _GRAIN)
