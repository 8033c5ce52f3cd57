"""Forward sensitivities of a reduced roll-out by the implicit function theorem.

At the solution y of a time step the gradient g of its incremental potential vanishes. With p the parameters,

    H dy/dp = −(∂g/∂p + ∂g/∂(past states) · d(past states)/dp),        H = ∂g/∂y, exact,

which takes one factorisation and P back-substitutions per solve. Frozen terms of a step (viscosity at the guess,
friction at the last state, then at the last pass) depend on past states and passes. They are differentiated too, so
that the result is the derivative of the discrete roll-out: central differences agree with it to their own error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from torch import Tensor

from physconvex.dynamics import State, StepCoefficients, StepRecord, Timing, extrapolate, step_coefficients
from physconvex.reduced.equations import ReducedEquations
from physconvex.reduced.flow_tangents import FlowingStep, FlowTangents
from physconvex.reduced.friction_tangents import friction_tangent
from physconvex.reduced.parameters import check_parameters, parameter_values
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.step_derivatives import StepDerivatives


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

    def observe(self, equations: ReducedEquations, record: StepRecord) -> None:
        """Advance over one converged step."""
        c, freeze = record.coefficients, self.derivatives.freeze
        history = self.previous if record.history is not None else None
        change = step_coefficients(self.state, history if record.two_step else None, record.step)
        guess = extrapolate(record.before, record.history, record.step)
        dguess = extrapolate(self.state, history, record.step)
        before = record.before
        frozen = freeze(before.positions, c.velocity(guess), before.time, self.state.positions, change.velocity(dguess))
        dx, lagged, dlagged = dguess, before.positions, self.state.positions
        state = self.body.deformation_gradient(guess).contiguous() if self.derivatives.viscous else None
        surface, dvelocity = equations.surface, equations.surface @ (-change.base / c.step)
        undo = None if equations.response is None else equations.response.undo
        for number, solved in enumerate(record.passes):
            if number:
                lagged, dlagged = record.passes[number - 1].x, dx
            equations.friction = solved.friction
            residual = self._residual(equations, (c, change), (state, dguess), solved.x)
            if self.flow is not None and undo is not None:
                equations.response = self.body.flow_step(undo, lagged, record.step)
                residual += self.flow.forces(FlowingStep(undo, record.step, lagged, dlagged), solved.x)
            velocity = surface @ c.velocity(solved.x)
            residual += surface.T @ friction_tangent(equations.contact, frozen, velocity, dvelocity)
            dx = -equations.exact_solve(solved.x, residual)
            frozen = freeze(solved.x, c.velocity(solved.x), record.after.time, dx, change.velocity(dx))
        if self.flow is not None and undo is not None:
            self.flow.advance(FlowingStep(undo, record.step, lagged, dlagged), record.passes[-1].x, dx)
        self.previous, self.state = self.state, State(record.after.time, dx, change.velocity(dx))

    def _residual(
        self,
        equations: ReducedEquations,
        coefficients: tuple[StepCoefficients, StepCoefficients],
        viscosity: tuple[Tensor | None, np.ndarray],
        x: np.ndarray,
    ) -> np.ndarray:
        """Derivative of the gradient at fixed x (without friction), [P, R, 3].

        Args:
            equations: of the step.
            coefficients: of the step, and their derivatives.
            viscosity: F* at which it is frozen, and the derivatives of the coordinates there.
            x: the solution of a pass.
        """
        (c, change), (state, dguess), scene = coefficients, viscosity, self.scene
        velocity, dv = c.velocity(x), -change.base / c.step  # the latter at fixed x
        out = self.derivatives.explicit(equations, c, x, state)
        out += self.body.mass @ (-change.target / c.step**2 + scene.air_drag * dv)
        if scene.wind is not None:
            blocks = equations.wind_blocks(velocity)
            out += equations.surface.T @ np.einsum("sij,psj->psi", blocks, equations.surface @ dv)
        if scene.damping_time > 0 and state is not None:
            for row, step, speed_up in zip(out, dguess, dv, strict=True):
                row += self.body.viscous_tangent(state, velocity, step, speed_up, scene.damping_time)
        return out


@dataclass(frozen=True, eq=False)
class NamedParameters:
    """A reduced scene and the names of parameters (`physconvex.reduced.PARAMETERS`, and the flow rule's).

    Each solve factorises one exact Hessian in addition to the roll-out, and back-substitutes once per parameter.
    """

    scene: ReducedScene
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))

    @cached_property
    def values(self) -> Float[np.ndarray, " P"]:
        """Present values of the parameters."""
        return parameter_values(self.scene, self.names)

    def tangents(self, timing: Timing) -> _Tangents:
        """Derivatives at the start of a roll-out.

        Raises:
            InputError: unknown names.
        """
        check_parameters(self.scene, self.names)
        return _Tangents(self.scene, self.names)
