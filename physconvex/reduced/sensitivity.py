"""Forward sensitivities of a reduced roll-out by the implicit function theorem.

The solution y of a time step is where the gradient g of its incremental potential vanishes. With p the parameters,

    H dy/dp = −(∂g/∂p + ∂g/∂(past states) · d(past states)/dp),        H = ∂g/∂y, exact,

one factorisation and P solves per solve. What a step freezes (viscosity at the guess, friction at the last state and
then at the last pass) depends on past states and earlier passes, and is differentiated too, so that the result is the
derivative of the discrete roll-out, which central differences must confirm to their own error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from physconvex.dynamics import State, StepCoefficients, StepRecord, bdf2, extrapolate, implicit_euler
from physconvex.numerics import one_torch_thread
from physconvex.reduced.equations import StepEquations
from physconvex.reduced.flow_tangents import FlowTangents
from physconvex.reduced.friction_tangents import friction_tangent
from physconvex.reduced.parameters import parameter_values
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.simulation import ReducedTrajectory, simulate
from physconvex.reduced.step_derivatives import StepDerivatives

__all__ = ["SensitiveTrajectory", "simulate_with_sensitivities"]


@dataclass(frozen=True)
class SensitiveTrajectory:
    """A roll-out and its derivatives.

    Attributes:
        trajectory: the roll-out.
        parameters: names of the parameters.
        values: their values, shape [P].
        coordinate_tangents: ∂y/∂p at the frames, shape [T, P, R, 3].
        velocity_tangents: ∂ẏ/∂p at the frames, shape [T, P, R, 3].
    """

    trajectory: ReducedTrajectory
    parameters: tuple[str, ...]
    values: Float[np.ndarray, " P"]
    coordinate_tangents: Float[np.ndarray, "T P R 3"]
    velocity_tangents: Float[np.ndarray, "T P R 3"]

    def position_tangents(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "T P n 3"]:
        """Derivatives of the positions of material points, given by their rest positions [m]."""
        return self.trajectory.space.shape_values(points) @ self.coordinate_tangents


class _Tangents:
    """Derivatives of the state with respect to P parameters, carried along step by step."""

    def __init__(self, scene: ReducedScene, names: Sequence[str]) -> None:
        self.derivatives = StepDerivatives(scene, names)
        self.scene, self.body = scene, scene.body
        self.state = self.derivatives.start()
        self.previous: State | None = None
        self.flow = None
        if scene.body.flow is not None:
            self.flow = FlowTangents(scene.body, *self.derivatives.lame_tangents(), names)

    def observe(self, equations: StepEquations, record: StepRecord) -> None:
        """Advance over one converged step."""
        c, freeze = record.coefficients, self.derivatives.freeze
        history = self.previous if record.history is not None else None
        two_step = record.two_step and history is not None
        change = (
            bdf2(self.state, history, record.step) if two_step and history else implicit_euler(self.state, record.step)
        )
        guess = extrapolate(record.before, record.history, record.step)
        dguess = extrapolate(self.state, history, record.step)
        before = record.before
        frozen = freeze(before.positions, c.velocity(guess), before.time, self.state.positions, change.velocity(dguess))
        dx, lagged, dlagged = dguess, before.positions, self.state.positions
        undo = None if equations.response is None else equations.response.undo
        for number, solved in enumerate(record.passes):
            if number:
                lagged, dlagged = record.passes[number - 1].x, dx
            equations.friction = solved.friction
            residual = self._residual(equations, c, change, solved.x, guess, dguess)
            if self.flow is not None and undo is not None:
                equations.response = self.body.flow_step(undo, lagged, record.step)
                residual += self.flow.forces(undo, record.step, solved.x, lagged, dlagged)
            velocity, dvelocity = self._surface_velocities(c, change, solved.x)
            residual += equations.surface.T @ friction_tangent(equations.contact, frozen, velocity, dvelocity)
            dx = -equations.exact_solve(solved.x, residual)
            frozen = freeze(solved.x, c.velocity(solved.x), record.after.time, dx, change.velocity(dx))
        if self.flow is not None and undo is not None:
            self.flow.advance(undo, record.step, record.passes[-1].x, dx, lagged, dlagged)
        self.previous, self.state = self.state, State(record.after.time, dx, change.velocity(dx))

    def _surface_velocities(
        self, c: StepCoefficients, change: StepCoefficients, x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Velocities of the surface samples, and their derivatives at fixed x."""
        surface = self.body.space.surface_values
        return surface @ c.velocity(x), surface @ (-change.base / c.step)

    def _residual(
        self,
        equations: StepEquations,
        c: StepCoefficients,
        change: StepCoefficients,
        x: np.ndarray,
        guess: np.ndarray,
        dguess: np.ndarray,
    ) -> np.ndarray:
        """Derivative of the gradient at fixed x (friction apart), [P, R, 3]."""
        body, scene = self.body, self.scene
        dv = -change.base / c.step  # of the velocity at fixed x
        state = body.deformation_gradient(guess).contiguous() if self.derivatives.viscous else None
        out = self.derivatives.explicit(equations, c, x, state)
        out += body.mass @ (-change.target / c.step**2 + scene.air_drag * dv)
        if scene.wind is not None:
            blocks = equations.wind_blocks(c.velocity(x))
            out += equations.surface.T @ np.einsum("sij,psj->psi", blocks, equations.surface @ dv)
        if scene.damping_time > 0 and state is not None:
            velocity = c.velocity(x)
            for row, step, speed_up in zip(out, dguess, dv, strict=True):
                row += body.viscous_tangent(state, velocity, step, speed_up, scene.damping_time)
        return out


@one_torch_thread()
def simulate_with_sensitivities(
    scene: ReducedScene, parameters: Sequence[str], *, frames: int = 24, **options: Any
) -> SensitiveTrajectory:
    """Roll out and differentiate by the named parameters (`physconvex.reduced.PARAMETERS`, and the flow rule's).

    One exact Hessian per solve is factorised beyond what the roll-out needs, and back-substituted once per parameter.
    The step size is not differentiated: where steps were halved, the derivative is that of the halved steps.

    Args:
        scene: body, forces, initial state.
        parameters: names.
        frames: number of states, the first at t = 0.
        options: of `simulate`; the error of the tangents is that of Newton's `tolerance`.

    Raises:
        InputError: unknown names, or options out of range.
        ConvergenceError: as in `simulate`.
    """
    values = parameter_values(scene, parameters)
    tangents = _Tangents(scene, parameters)
    states = [tangents.state]
    run = simulate(
        scene, frames=frames, observer=tangents.observe, on_frame=lambda _: states.append(tangents.state), **options
    )
    return SensitiveTrajectory(
        trajectory=run,
        parameters=tuple(parameters),
        values=values,
        coordinate_tangents=np.stack([s.positions for s in states]),
        velocity_tangents=np.stack([s.velocities for s in states]),
    )
