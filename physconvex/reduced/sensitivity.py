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
import torch
from jaxtyping import Float
from scipy.linalg import lu_factor, lu_solve

from physconvex.integrators import State, StepCoefficients, bdf2, implicit_euler
from physconvex.reduced.body import inner_viscous_stress, viscous_stress
from physconvex.reduced.equations import StepEquations
from physconvex.reduced.friction_tangents import FreezeTangent, friction_tangent
from physconvex.reduced.parameters import axis_of, check_parameters, mean_density, parameter_values
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.simulation import ReducedTrajectory, StepRecord, extrapolate, simulate

__all__ = ["SensitiveTrajectory", "simulate_with_sensitivities"]

_LN10 = float(np.log(10.0))


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


def _lame_slopes(youngs_modulus: torch.Tensor, poisson_ratio: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """∂μ/∂ν and ∂λ/∂ν [Pa]."""
    e, nu = youngs_modulus, poisson_ratio
    return -e / (2 * (1 + nu) ** 2), e * (1 + 2 * nu**2) / ((1 + nu) * (1 - 2 * nu)) ** 2


class _Tangents:
    """Derivatives of the state with respect to P parameters, carried along step by step."""

    def __init__(self, scene: ReducedScene, names: Sequence[str]) -> None:
        self.scene, self.body, self.names = scene, scene.body, tuple(names)
        self.surface = scene.body.space.surface_values
        self.contact = scene.contact()
        follows = scene.contact_stiffness is None and "log10_contact_stiffness" not in names
        stiffening = {"log10_contact_stiffness"} | ({"log10_youngs_modulus"} if follows else set())
        self.dlog_stiffness = np.array([_LN10 if name in stiffening else 0.0 for name in names])
        self.dfriction = np.array([float(name == "friction") for name in names])
        cells = torch.as_tensor(self.body.space.samples.interior.cells, device=self.body.device)
        constants = (
            torch.as_tensor(c, device=self.body.device) for c in (self.body.youngs_modulus, self.body.poisson_ratio)
        )
        self.dmu, self.dlam = (slope[cells] for slope in _lame_slopes(*constants))
        self.state, self.previous = self._start(), None

    previous: State | None

    def _start(self) -> State:
        scene, space = self.scene, self.body.space
        zero = np.zeros((len(self.names), *scene.start.shape))
        positions, velocities = zero.copy(), zero.copy()
        center = self.body.first_moments @ scene.start / self.body.total_mass
        for i, name in enumerate(self.names):
            stem, _, _ = name.rpartition("_")
            if not stem.startswith("initial"):
                continue
            unit = np.eye(3)[axis_of(name)[1]]
            if stem == "initial_position":
                positions[i] = space.affine(np.zeros((3, 3)), unit)
            elif stem == "initial_velocity":
                velocities[i] = space.affine(np.zeros((3, 3)), unit)
            else:
                shift = space.affine(np.zeros((3, 3)), np.cross(unit, center))
                velocities[i] = np.cross(unit, scene.start) - shift
        return State(0.0, positions, velocities)

    def observe(self, equations: StepEquations, record: StepRecord) -> None:
        """Advance over one converged step."""
        history = self.previous if record.history is not None else None
        if record.two_step:
            assert history is not None
            change = bdf2(self.state, history, record.step)
        else:
            change = implicit_euler(self.state, record.step)
        guess = extrapolate(record.before, record.history, record.step)
        dguess = extrapolate(self.state, history, record.step)
        c = record.coefficients
        frozen = self._frozen(
            record.before.positions,
            c.velocity(guess),
            record.before.time,
            self.state.positions,
            change.velocity(dguess),
        )
        dx = dguess
        for solved in record.passes:
            equations.friction = solved.friction
            residual = self._residual(equations, c, change, solved.x, guess, dguess)
            velocity, dvelocity = self.surface @ c.velocity(solved.x), self.surface @ (-change.base / c.step)
            residual += self.surface.T @ friction_tangent(self.contact, frozen, velocity, dvelocity)
            factor = lu_factor(equations.hessian(solved.x), check_finite=False)
            columns = residual.reshape(len(residual), -1).T
            dx = -lu_solve(factor, columns, check_finite=False).T.reshape(residual.shape)
            frozen = self._frozen(solved.x, c.velocity(solved.x), record.after.time, dx, change.velocity(dx))
        self.previous, self.state = self.state, State(record.after.time, dx, change.velocity(dx))

    def _frozen(self, y: np.ndarray, v: np.ndarray, time: float, dy: np.ndarray, dv: np.ndarray) -> FreezeTangent:
        s = self.surface
        return FreezeTangent(s @ y, s @ v, time, s @ dy, s @ dv, self.dlog_stiffness, self.dfriction)

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
        body, scene, v = self.body, self.scene, c.velocity(x)
        dv = -change.base / c.step  # of the velocity at fixed x
        state = body.deformation_gradient(guess)
        rate = body.deformation_gradient(v)
        viscous = body.forces_of(viscous_stress(state, rate, body.mu, body.lam))  # per damping time
        out = np.stack([self._explicit(equations, name, c, x, state, rate, viscous) for name in self.names])
        out += body.mass @ (-change.target / c.step**2 + scene.air_drag * dv)
        if scene.damping_time > 0:
            mu, lam = scene.damping_time * body.mu, scene.damping_time * body.lam
            dstate, drate = body.deformation_gradient(dguess), body.deformation_gradient(dv)
            stress = dstate @ inner_viscous_stress(state, rate, mu, lam) + state @ (
                inner_viscous_stress(dstate, rate, mu, lam) + inner_viscous_stress(state, drate, mu, lam)
            )
            out += body.forces_of(stress)
        return out

    def _explicit(
        self,
        equations: StepEquations,
        name: str,
        c: StepCoefficients,
        x: np.ndarray,
        state: torch.Tensor,
        rate: torch.Tensor,
        viscous: np.ndarray,
    ) -> np.ndarray:
        """∂g/∂p at fixed states, [R, 3]; every law is linear in μ and λ, contact is linear in kc."""
        body, scene = self.body, self.scene
        match name:
            case "log10_youngs_modulus":
                force = body.gradient(x) + scene.damping_time * viscous
                return _LN10 * force + self._stiffening(equations, name, x)
            case "log10_contact_stiffness":
                return self._stiffening(equations, name, x)
            case "poisson_ratio":
                stress = body.law.stress(body.deformation_gradient(x), self.dmu, self.dlam)
                drag = viscous_stress(state, rate, scene.damping_time * self.dmu, scene.damping_time * self.dlam)
                return body.forces_of(stress + drag)
            case "density":
                weight = body.first_moments[:, None] * np.asarray(scene.gravity)
                pull = (x - c.target) / c.step**2 + scene.air_drag * c.velocity(x)
                return (body.mass @ pull - weight) / mean_density(body)
            case "damping_time":
                return viscous
            case "air_drag":
                return body.mass @ c.velocity(x)
            case "gravity_x" | "gravity_y" | "gravity_z":
                return -body.first_moments[:, None] * np.eye(3)[axis_of(name)[1]]
        return np.zeros_like(x)

    def _stiffening(self, equations: StepEquations, name: str, x: np.ndarray) -> np.ndarray:
        _, push = self.contact.energy_and_gradient(self.surface @ x, equations.time)
        return self.dlog_stiffness[self.names.index(name)] * (self.surface.T @ push)


def simulate_with_sensitivities(
    scene: ReducedScene, parameters: Sequence[str], *, frames: int = 24, **options: Any
) -> SensitiveTrajectory:
    """Roll out and differentiate by the named parameters (`physconvex.reduced.PARAMETERS`).

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
    check_parameters(scene, parameters)
    tangents = _Tangents(scene, parameters)
    states = [tangents.state]
    run = simulate(
        scene, frames=frames, observer=tangents.observe, on_frame=lambda _: states.append(tangents.state), **options
    )
    return SensitiveTrajectory(
        trajectory=run,
        parameters=tuple(parameters),
        values=parameter_values(scene, parameters),
        coordinate_tangents=np.stack([s.positions for s in states]),
        velocity_tangents=np.stack([s.velocities for s in states]),
    )
