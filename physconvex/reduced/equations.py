"""The function that one time step of a reduced body minimises."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from torch import Tensor

from physconvex.dynamics import Friction, State, StepCoefficients
from physconvex.materials import FlowStep
from physconvex.reduced.dense_newton import DenseNewton
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.surface_contact import SurfaceContact, add_surface_blocks, contact_blocks


class ReducedEquations(DenseNewton):
    """Incremental potential of one time step in the reduced coordinates, an `Objective` with a dense Hessian."""

    def __init__(self, scene: ReducedScene) -> None:
        super().__init__(scene.body.space.samples.size)
        self.scene, self.body = scene, scene.body
        self.contact = scene.contact()
        self.surface = scene.body.space.surface_values
        self.touch = SurfaceContact(self.contact, self.surface)
        self.pins = scene.pin_springs()
        self.areas = scene.body.space.samples.surface_areas
        self.start = scene.start
        self.rounding = 1e-15 * self.body.shear_scale
        self.forces = scene.external_forces(0.0)
        self.time = 0.0
        self.viscous: Tensor | None = None
        self._viscous_stiffness: tuple[Tensor, np.ndarray] | None = None
        self.friction: tuple[Friction, ...] = ()
        self.undo = None if self.body.flow is None else self.body.unflowed()  # F_f⁻¹, stored from step to step
        self.response: FlowStep | None = None
        self._duration = 0.0

    def set_step(self, coefficients: StepCoefficients, time: float, guess: np.ndarray, last: State) -> None:
        """Fix everything that is constant during one time step.

        As in the full model: viscosity is frozen at the guess; friction and sand take normal forces and pressure from
        the last state.
        """
        self.begin(coefficients)
        self.time, self._duration, self.forces = time, time - last.time, self.scene.external_forces(time)
        self.viscous = self.body.deformation_gradient(guess).contiguous() if self.scene.damping_time > 0 else None
        self._freeze(last.positions, coefficients.velocity(guess), last.time)

    def freeze_friction(self, y: Float[np.ndarray, "R 3"]) -> bool:
        """Update frozen terms of a solve (friction, pressure in sand) at coordinates y; returns whether any exist."""
        assert self.coefficients is not None
        self._freeze(y, self.coefficients.velocity(y), self.time)
        return bool(self.friction) or (self.body.flow is not None and self.body.flow.lagged)

    def commit(self, x: Float[np.ndarray, "R 3"]) -> None:
        """Store the flow at the end of a step with coordinates x."""
        if self.response is not None:
            self.undo = self.response.flowed(self.body.deformation_gradient(x))

    def settled(self, change: Float[np.ndarray, "R 3"], step: float) -> bool:
        """Whether this change [m] changes the surface's velocities by at most the slip velocity."""
        return bool(np.abs(self.surface @ change).max(initial=0.0) <= step * self.contact.slip_velocity)

    def flowed(self) -> tuple[Float[np.ndarray, "Q *K 3 3"] | None]:
        """F_f at the interior samples; None for an elastic body."""
        return (None if self.undo is None else np.linalg.inv(self.undo.cpu().numpy()),)

    def _freeze(self, y: np.ndarray, velocity: np.ndarray, time: float) -> None:
        self.secants.interrupt()
        self.friction = self.contact.freeze_friction(self.surface @ y, self.surface @ velocity, time)
        if self.undo is not None:
            self.response = self.body.flow_step(self.undo, y, self._duration)

    # -- value and gradient

    def energy(self, state: State) -> float:
        """Energy [J]: kinetic, elastic, of contact and pins, and potential of the forces at the state's time."""
        y, v = state.positions, state.velocities
        total = 0.5 * float((v * (self.body.mass @ v)).sum()) + self.body.energy(y)
        total += self.touch.energy_and_gradient(y, state.time)[0]
        if self.pins is not None:
            total += self.pins.energy_and_gradient(y, state.time)[0]
        return total - float((self.scene.external_forces(state.time) * (y - self.start)).sum())

    def evaluate(self, x: Float[np.ndarray, "R 3"]) -> tuple[float, Float[np.ndarray, "R 3"]]:
        """Incremental potential [J] and its derivative [N]."""
        energy, gradient = self.body.energy_and_gradient(x, response=self.response)
        touch, push = self.touch.energy_and_gradient(x, self.time)
        energy += touch - float((self.forces * (x - self.start)).sum())
        gradient = gradient + push - self.forces
        if self.pins is not None:
            stretch, hold = self.pins.energy_and_gradient(x, self.time)
            energy, gradient = energy + stretch, gradient + hold
        if self.coefficients is not None:
            offset = x - self.coefficients.target
            pull = self.body.mass @ offset / self.coefficients.step**2
            loss, drag = self.dissipation(self.coefficients.velocity(x))
            energy += 0.5 * float((offset * pull).sum()) + self.coefficients.step * loss
            gradient = gradient + pull + drag
        self.secants.note(x, gradient)
        return energy, gradient

    def dissipation(self, velocity: Float[np.ndarray, "R 3"]) -> tuple[float, Float[np.ndarray, "R 3"]]:
        """Rate potential [W] of friction, viscosity, drag and wind; generalised forces against the motion [N]."""
        loss, force = self.touch.friction(self.friction, velocity)
        if self.viscous is not None:
            power, push = self.body.viscous_energy_and_gradient(self.viscous, velocity, self.scene.damping_time)
            loss, force = loss + power, force + push
        if self.scene.wind is not None:
            power, blow = self.scene.wind.energy_and_gradient(self.surface @ velocity, self.areas, self.time)
            loss, force = loss + power, force + self.surface.T @ blow
        if self.scene.air_drag > 0:
            momentum = self.scene.air_drag * (self.body.mass @ velocity)
            loss, force = loss + 0.5 * float((velocity * momentum).sum()), force + momentum
        return loss, force

    # -- Hessian

    def hessian_blocks(self, x: Float[np.ndarray, "R 3"], *, project: bool) -> Float[np.ndarray, "3 R 3 R"]:
        """Second derivative [N/m], components first; exact, or its positive definite approximation."""
        step = np.inf if self.coefficients is None else self.coefficients.step
        matrix = self.body.stiffness_blocks(x, project=project, response=self.response)
        if self.viscous is not None:
            matrix += self._viscous_blocks(self.viscous, self.scene.damping_time / step)
        add_surface_blocks(matrix, self.surface, self._sample_blocks(x, step, project=project))
        inertia = np.zeros_like(self.body.mass) if self.pins is None else self.pins.matrix
        if np.isfinite(step):
            inertia = inertia + (1 / step**2 + self.scene.air_drag / step) * self.body.mass
        for i in range(3):
            matrix[i, :, i] += inertia
        return matrix

    def _viscous_blocks(self, state: Tensor, ratio: float) -> np.ndarray:
        """Stiffness of the viscosity, the same in the whole step."""
        if self._viscous_stiffness is None or self._viscous_stiffness[0] is not state:
            self._viscous_stiffness = state, self.body.viscous_blocks(state, ratio)
        return self._viscous_stiffness[1]

    def _sample_blocks(self, x: np.ndarray, step: float, *, project: bool) -> Float[np.ndarray, "S 3 3"]:
        """Second derivatives by the positions of the surface samples."""
        at = self.surface @ x
        blocks = self.contact.hessian_blocks(at, self.time) if project else contact_blocks(self.contact, at, self.time)
        if self.friction:
            blocks = blocks + self.contact.friction_blocks(self.friction) / step
        if self.coefficients is not None and self.scene.wind is not None:
            blocks = blocks + self.wind_blocks(self.coefficients.velocity(x)) / step
        return blocks

    def wind_blocks(self, velocity: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "S 3 3"]:
        """Derivative of the force of the wind on the surface samples by their velocities [N·s/m]; zero without wind."""
        if self.scene.wind is None:
            return np.zeros((len(self.areas), 3, 3))
        return self.scene.wind.blocks(self.surface @ velocity, self.areas, self.time)
