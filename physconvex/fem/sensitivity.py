"""Forward sensitivities of a full-order roll-out: derivatives by its parameters, carried along step by step.

At the solution x of a time step the gradient g(x, past states, p) of its incremental potential vanishes, so that

    ∂g/∂x dx/dp + ∂g/∂(past states) d(past states)/dp + ∂g/∂p = 0.

The left side is one directional derivative of g, taken by central differences of g itself (two evaluations, no matrix).
dx/dp follows by iteration with the factorisation of Newton's method. Everything that a step freezes (viscosity at the
guess, friction at the start and at each preceding pass) is frozen on both sides of the difference, and so
differentiated pass by pass, as the step is computed. (The derivative of fully converged passes is different, and for a
sticking point it can be a hundred times as large.) Any parameter that a scene can be built from is possible.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import State, StepRecord, Timing, extrapolate, step_coefficients
from physconvex.errors import ConvergenceError, InputError
from physconvex.fem.nodal_equations import NodalEquations
from physconvex.fem.scene import Scene
from physconvex.numerics import NotPositiveDefiniteError

_TOLERANCE = 1e-3  # of the largest component of a tangent
_FLOOR = 2e-10  # of the body's size: a change of positions over the whole difference that counts as zero
_MOST = 16  # corrections per pass
_LOOSE = 1.0  # relative change after the last of them that is still accepted
_SLOW = 0.4  # contraction above which the matrix is factorised again


class _Tangent:
    """The derivative of the state by one parameter, from the equations with the parameter changed to both sides.

    Args:
        scene_of: as in `SceneFamily`.
        values: of the parameters.
        place: of this one.
        changes: of its value, the higher one first.
    """

    def __init__(
        self, scene_of: Callable[[np.ndarray], Scene], values: np.ndarray, place: int, changes: tuple[float, float]
    ) -> None:
        self.changes, self.span = changes, changes[0] - changes[1]
        ahead, behind = (scene_of(values + change * np.eye(len(values))[place]) for change in changes)
        self.sides = NodalEquations(ahead), NodalEquations(behind)
        speed = self._difference(ahead.start_velocities(), behind.start_velocities())
        self.state = State(0.0, self._difference(ahead.start, behind.start), speed)
        self.previous: State | None = None

    def _difference(self, ahead: np.ndarray, behind: np.ndarray) -> np.ndarray:
        return (ahead - behind) / self.span

    def set_step(self, record: StepRecord) -> np.ndarray:
        """Fix what is constant during the step of a record on both sides; a first guess of the new tangent."""
        history = self.previous if record.history is not None else None
        time, guesses = record.after.time, []
        for equations, change in zip(self.sides, self.changes, strict=True):
            before = _moved(record.before, self.state, change)
            past = None if record.history is None or history is None else _moved(record.history, history, change)
            coefficients = step_coefficients(before, past if record.two_step else None, record.step)
            guesses.append(equations.first_guess(extrapolate(before, past, record.step), time))
            equations.set_step(coefficients, time, guesses[-1], before)
        guess = extrapolate(self.state, history, record.step)
        guess[self.sides[0].fixed] = self._difference(*guesses)[self.sides[0].fixed]  # the pinned nodes
        return guess

    def freeze_friction(self, x: np.ndarray, tangent: np.ndarray) -> None:
        """Begin another pass, from the solution of the last one."""
        for equations, change in zip(self.sides, self.changes, strict=True):
            equations.freeze_friction(x + change * tangent)

    def residual(self, x: np.ndarray, tangent: np.ndarray) -> np.ndarray:
        """The directional derivative of g at a solution."""
        sides = zip(self.sides, self.changes, strict=True)
        return self._difference(*(equations.gradient(x + change * tangent) for equations, change in sides))

    def relative(self, update: np.ndarray, tangent: np.ndarray) -> float:
        """Size of an update relative to the resulting tangent."""
        least = _FLOOR * self.sides[0].body.mesh.size / self.span
        return float(np.abs(update).max() / max(np.abs(tangent - update).max(), least))

    def advance(self, record: StepRecord, tangent: np.ndarray) -> None:
        """Take the new tangent over."""
        history = self.previous if record.two_step else None
        change = step_coefficients(self.state, history, record.step)
        self.previous, self.state = self.state, State(record.after.time, tangent, change.velocity(tangent))


def _moved(state: State, tangent: State, change: float) -> State:
    return State(
        state.time, state.positions + change * tangent.positions, state.velocities + change * tangent.velocities
    )


class _Tangents:
    """The derivatives by all parameters, carried along a roll-out."""

    def __init__(self, tangents: list[_Tangent]) -> None:
        self.tangents = tangents

    def observe(self, equations: NodalEquations, record: StepRecord) -> None:
        found = [tangent.set_step(record) for tangent in self.tangents]
        for number, solved in enumerate(record.passes):
            if number:
                for tangent, x in zip(self.tangents, found, strict=True):
                    tangent.freeze_friction(record.passes[number - 1].x, x)
            equations.friction = solved.friction
            found = self._solved(equations, solved.x, found)
        for tangent, x in zip(self.tangents, found, strict=True):
            tangent.advance(record, x)

    def _solved(self, equations: NodalEquations, x: np.ndarray, guess: list[np.ndarray]) -> list[np.ndarray]:
        """The tangents at the solution x of one pass.

        Raises:
            ConvergenceError: they do not converge.
        """
        found, last, renewed = guess, np.inf, False
        for _ in range(_MOST):
            residuals = [t.residual(x, dx) for t, dx in zip(self.tangents, found, strict=True)]
            updates = [equations.solve(residual) for residual in residuals]
            triples = zip(self.tangents, updates, found, strict=True)
            size = max(tangent.relative(update, dx) for tangent, update, dx in triples)
            if not size <= _SLOW * last and not renewed:  # a matrix of another pass may diverge
                renewed, last, found = _renewed(equations, x), np.inf, guess
                continue
            share = 1.0 if size <= _SLOW * last else 0.5  # oscillation about a corner of the contact
            last = size
            found = [dx - share * update for dx, update in zip(found, updates, strict=True)]
            if size <= _TOLERANCE:
                return found
        if not last <= _LOOSE:
            raise ConvergenceError(f"derivatives of a time step did not settle: their last change was {last:.1g}")
        return found

    @property
    def state(self) -> State:
        """Derivatives of the state by all parameters, shape [K, V, 3]."""
        states = [tangent.state for tangent in self.tangents]
        return State(
            states[0].time if states else 0.0,
            np.stack([state.positions for state in states]),
            np.stack([state.velocities for state in states]),
        )


def _renewed(equations: NodalEquations, x: np.ndarray) -> bool:
    try:
        equations.factorise(x, project=False)
    except NotPositiveDefiniteError:
        equations.factorise(x, project=True)
    return True


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneFamily:
    """Scenes of finite elements that differ by parameters.

    Attributes:
        scene_of: from K parameter values to the scene; mesh and pinned nodes must not depend on them.
        values: of the parameters, shape [K].
        steps: half widths of the central differences: about 1e-4 of a typical change of each.
        lower, upper: the differences stay within these bounds, one-sided if necessary.
        names: of the parameters; numbers unless given.

    Raises:
        InputError: steps that are not positive.
    """

    scene_of: Callable[[Float[np.ndarray, " K"]], Scene]
    values: Float[np.ndarray, " K"]
    steps: Sequence[float] | Float[np.ndarray, " K"]
    lower: Sequence[float] | Float[np.ndarray, " K"] | None = None
    upper: Sequence[float] | Float[np.ndarray, " K"] | None = None
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        at, widths = np.asarray(self.values, dtype=np.float64), np.asarray(self.steps, dtype=np.float64)
        if at.shape != widths.shape or not (widths > 0).all():
            raise InputError(f"steps: got {widths.tolist()} for {len(at)} values; expected one positive width for each")
        object.__setattr__(self, "values", at)
        object.__setattr__(self, "names", self.names or tuple(str(number) for number in range(len(at))))

    @cached_property
    def scene(self) -> Scene:
        """At the values."""
        return self.scene_of(self.values)

    def tangents(self, timing: Timing) -> _Tangents:
        """Derivatives at the start of a roll-out.

        Raises:
            InputError: a body that flows, or a timing without derivatives.
        """
        if timing.contact_solver != "passes" or timing.flight_steps_per_frame is not None:
            raise InputError(
                "simulate_with_sensitivities: got contact_solver or flight_steps_per_frame; expected contact by passes "
                "and steps of one length, which the derivatives follow. Leave both options out"
            )
        if self.scene.body.flow is not None or self.scene.hanging is not None:
            raise InputError("simulate_with_sensitivities: the body flows or carries a hanging load; expected neither")
        at, widths = self.values, np.asarray(self.steps, dtype=np.float64)
        low = -widths if self.lower is None else np.maximum(-widths, np.asarray(self.lower) - at)
        high = widths if self.upper is None else np.minimum(widths, np.asarray(self.upper) - at)
        return _Tangents([_Tangent(self.scene_of, at, k, (float(high[k]), float(low[k]))) for k in range(len(at))])
