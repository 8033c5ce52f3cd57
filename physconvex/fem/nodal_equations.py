"""The equations of one time step of an elastic body, or of its rest."""

from __future__ import annotations

import weakref

import numpy as np

from physconvex.dynamics import Friction, State, StepCoefficients
from physconvex.fem.assembly import Assembler
from physconvex.fem.carried_contact import CarriedContact
from physconvex.fem.hanging_load import Hanging
from physconvex.fem.scene import Scene
from physconvex.materials import FlowStep, StepViscosity
from physconvex.numerics import SymmetricSolver


class NodalEquations:
    """Incremental potential of one time step (or, without inertia, the static potential) as an `Objective`."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.body = scene, scene.body
        self.contact = scene.contact()
        self.assembler = Assembler(self.body.mesh.tets, scene.free_nodes())
        self.solver = SymmetricSolver(self.assembler.pattern)
        weakref.finalize(self, self.solver.close)
        self.fixed = ~scene.free_nodes()
        self._mass_data = self._assemble_mass()
        width = 3 * self.body.mesh.tets.shape[1]
        self._element_matrices = np.empty((len(self.body.mesh.tets), width, width))
        self.factorised = False
        self.rounding = 1e-15 * self.body.shear_scale
        self._factorised_step = np.nan
        self.coefficients: StepCoefficients | None = None
        self.forces = scene.external_forces(0.0)
        self.time = 0.0
        self.viscosity: StepViscosity | None = None
        self.friction: tuple[Friction, ...] = ()
        self.freezes_friction = True  # as a step begins
        self.undo = None if self.body.flow is None else self.body.unflowed()  # F_f⁻¹, stored from step to step
        self.response: FlowStep | None = None
        self._duration = 0.0
        gravity, load = np.asarray(scene.gravity, dtype=np.float64), scene.hanging
        self.hanging = None if load is None else Hanging(load, scene.hanging_masses, gravity, scene.start)

    def _assemble_mass(self) -> np.ndarray:
        pattern = self.assembler.pattern.tocoo()
        free = np.flatnonzero(self.assembler.free)
        same = pattern.row % 3 == pattern.col % 3
        values = np.zeros(len(pattern.row))
        mass = self.body.mass[free[pattern.row[same] // 3], free[pattern.col[same] // 3]]
        values[same] = np.asarray(mass).ravel()
        return values

    @property
    def factorisations(self) -> int:
        """Number of factorisations of Newton's matrix."""
        return self.solver.factorisations

    def first_guess(self, guess: np.ndarray, time: float) -> np.ndarray:
        """The guess with pinned nodes where they are at the time [s]."""
        if (pins := self.scene.held) is not None:
            guess[pins.nodes] = pins.positions(time, self.scene.start)
        return guess

    def set_step(self, coefficients: StepCoefficients, time: float, guess: np.ndarray, last: State) -> None:
        """Fix everything that is constant during one time step.

        Viscosity is frozen at the guess. Friction takes its normal forces from the last state: at an impact the guess
        penetrates the obstacle far too deep, and friction would stop the body.
        """
        self.coefficients, self.time, self._duration = coefficients, time, time - last.time
        self.forces = self.scene.external_forces(time)
        if self.factorised and not np.isclose(coefficients.step, self._factorised_step):
            self.factorised = False
        if self.hanging is not None:
            before = self.hanging.share
            self.hanging.set_step(coefficients, time, guess, last)
            self.forces = self.forces + self.hanging.force()
            self.factorised = self.factorised and self.hanging.share == before
        self.viscosity = None
        if (damping_time := self.scene.damping_time) > 0:
            state = self.body.deformation_gradient(guess)
            self.viscosity = StepViscosity(state, damping_time, coefficients.step)
        if self.freezes_friction:
            self.friction = self.contact.freeze_friction(last.positions, coefficients.velocity(guess), last.time)
        self._freeze_flow(last.positions)

    def freeze_friction(self, x: np.ndarray) -> bool:
        """Update frozen terms of a solve (friction, sand's pressure) at positions x; returns whether there are any."""
        assert self.coefficients is not None
        self.friction = self.contact.freeze_friction(x, self.coefficients.velocity(x), self.time)
        self._freeze_flow(x)
        return bool(self.friction) or (self.body.flow is not None and self.body.flow.lagged)

    def settled(self, change: np.ndarray, step: float) -> bool:
        """Whether this change [m] changes the velocities by at most the slip velocity."""
        return bool(np.abs(change).max() <= step * self.contact.slip_velocity)

    def commit(self, x: np.ndarray) -> None:
        """Store the flow at the end of a step with positions x."""
        if self.hanging is not None and self.coefficients is not None:
            self.hanging.commit(self.coefficients.velocity(x))
        if self.response is not None:
            self.undo = self.response.flowed(self.body.deformation_gradient(x))

    def flowed(self) -> tuple[None]:
        """Nothing is kept."""
        return (None,)

    def _freeze_flow(self, x: np.ndarray) -> None:
        if self.undo is not None:
            self.response = self.body.flow_step(self.undo, x, self._duration)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """The gradient [N] alone."""
        return self.evaluate(x, with_energy=False)[1]

    def evaluate(self, x: np.ndarray, *, with_energy: bool = True) -> tuple[float, np.ndarray]:
        """The potential [J], which may be NaN without `with_energy`, and its gradient [N]."""
        energy, gradient = self._body_energy_and_gradient(x, with_energy=with_energy)
        touch, push = self.contact.energy_and_gradient(x, self.time)
        energy += touch - float((self.forces * (x - self.scene.start)).sum())
        gradient = gradient + push - self.forces
        if self.coefficients is not None:
            inertia, pull = self._inertia(x, self.coefficients)
            loss, drag = self._dissipation(self.coefficients.velocity(x))
            energy += inertia + self.coefficients.step * loss
            gradient = gradient + pull + drag
        gradient[self.fixed] = 0.0
        return energy, gradient

    def smooth_gradient(self, x: np.ndarray) -> np.ndarray:
        """The gradient [N] without contact and friction."""
        _, gradient = self._body_energy_and_gradient(x, with_energy=False)
        gradient = gradient - self.forces
        if self.coefficients is not None:
            gradient = gradient + self._inertia(x, self.coefficients)[1]
            gradient = gradient + self._resistance(self.coefficients.velocity(x))[1]
        gradient[self.fixed] = 0.0
        return gradient

    def _body_energy_and_gradient(self, x: np.ndarray, *, with_energy: bool) -> tuple[float, np.ndarray]:
        """Energy and gradient of elasticity, and of viscosity during a time step."""
        if self.coefficients is None or self.viscosity is None:
            return self.body.energy_and_gradient(x, response=self.response)
        return self.body.moving_energy_and_gradient(
            x, self.coefficients.velocity(x), self.viscosity, response=self.response, with_energy=with_energy
        )

    def _inertia(self, x: np.ndarray, c: StepCoefficients) -> tuple[float, np.ndarray]:
        offset = x - c.target
        pull = self.body.mass @ offset / c.step**2
        energy = 0.5 * float((offset * pull).sum())
        if self.hanging is not None:
            offset = x - self.hanging.target
            own = self.hanging.active[:, None] * offset / c.step**2
            energy, pull = energy + 0.5 * float((offset * own).sum()), pull + own
        return energy, pull

    def _dissipation(self, velocity: np.ndarray) -> tuple[float, np.ndarray]:
        loss, force = self._resistance(velocity)
        rub, hold = self.contact.friction_energy_and_gradient(self.friction, velocity)
        return loss + rub, force + hold

    def _resistance(self, velocity: np.ndarray) -> tuple[float, np.ndarray]:
        """Rate potential and force of the air."""
        loss, force = 0.0, np.zeros_like(velocity)
        if self.scene.wind is not None:
            power, blow = self.scene.wind.energy_and_gradient(velocity, self.body.mesh.node_areas, self.time)
            loss, force = loss + power, force + blow
        if self.scene.air_drag > 0:
            momentum = self.scene.air_drag * (self.body.mass @ velocity)
            loss, force = loss + 0.5 * float((velocity * momentum).sum()), force + momentum
        return loss, force

    def factorise(self, x: np.ndarray, *, project: bool, contact: bool = True) -> None:
        """Factorise Newton's matrix, or without contact the derivative of `smooth_gradient`."""
        self.factorised = False
        step = np.inf if self.coefficients is None else self.coefficients.step
        local = self.body.element_hessians(
            x, project=project, viscosity=self.viscosity, response=self.response, out=self._element_matrices
        )
        blocks = self.contact.hessian_blocks(x, self.time) if contact else None
        inertia, wind = 0.0, None
        if self.coefficients is not None:
            inertia = 1 / step**2 + self.scene.air_drag / step
            if self.friction and blocks is not None:
                blocks += self.contact.friction_blocks(self.friction) / step
            if self.hanging is not None and blocks is not None:
                blocks = blocks + (self.hanging.active / step**2)[:, None, None] * np.eye(3)
            if self.scene.wind is not None:
                velocity = self.coefficients.velocity(x)
                wind = self.scene.wind.blocks(velocity, self.body.mesh.node_areas, self.time) / step
            self._factorised_step = step
        data = self._with_contact(local, blocks) + inertia * self._mass_data
        if wind is not None:
            data = data + self.assembler.blocks(wind)
        self.solver.factorise(data)
        self.factorised = contact

    def _with_contact(self, local: np.ndarray, blocks: np.ndarray | None) -> np.ndarray:
        """Entries of the matrix: of the elements, and of contact at nodes or at points that elements carry, if any."""
        if blocks is None:
            return self.assembler.elements(local)
        if isinstance(self.contact, CarriedContact):
            self.contact.add_to_elements(local, blocks)
            return self.assembler.elements(local)
        return self.assembler.elements(local) + self.assembler.blocks(blocks)

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        out = np.zeros_like(rhs)
        out[self.assembler.free] = self.solver.solve(rhs[self.assembler.free].reshape(-1)).reshape(-1, 3)
        return out
