"""Derivatives of one time step's gradient by its parameters, shared by the forward and the adjoint sensitivities."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.dynamics import State, StepCoefficients
from physconvex.numerics import rotation_matrix, turning_rates
from physconvex.reduced.equations import ReducedEquations
from physconvex.reduced.friction_tangents import FreezeTangent
from physconvex.reduced.parameters import axis_of, cells_of, check_parameters, mean_density, region_of
from physconvex.reduced.scene import ReducedScene
from physconvex.reduced.surface_contact import by_height_of_planes

_LN10 = float(np.log(10.0))


def _lame_slopes(youngs_modulus: Tensor, poisson_ratio: Tensor) -> tuple[Tensor, Tensor]:
    """∂μ/∂ν and ∂λ/∂ν [Pa]."""
    e, nu = youngs_modulus, poisson_ratio
    return -e / (2 * (1 + nu) ** 2), e * (1 + 2 * nu**2) / ((1 + nu) * (1 - 2 * nu)) ** 2


class StepDerivatives:
    """Explicit dependence of a scene on its named parameters.

    Args:
        scene: the scene.
        names: P different names of `physconvex.reduced.PARAMETERS`, or none.

    Attributes:
        dlog_stiffness: derivative of ln kc, shape [P]; a default contact stiffness follows E unless it is named too.
        dfriction: derivative of the friction coefficients, shape [P].
        ddamping: derivative of the time of the contact's dashpot, shape [P].
        drise: derivative of the height of planes, shape [P].
        viscous: whether the body is damped, or its damping is a parameter.

    Raises:
        InputError: unknown names, or the same twice.
    """

    def __init__(self, scene: ReducedScene, names: Sequence[str]) -> None:
        if names:
            check_parameters(scene, names)
        self.scene, self.body, self.names = scene, scene.body, tuple(names)
        self.surface = scene.body.space.surface_values
        follows = scene.contact_stiffness is None and "log10_contact_stiffness" not in names
        self.dlog_stiffness = np.array(
            [_LN10 * (name == "log10_contact_stiffness" or (follows and self._stiffest(name))) for name in names]
        )
        self._heavier = {name: self._mass_of(name) for name in names if region_of(name)[0] == "density"}
        self.dfriction = np.array([float(name == "friction") for name in names])
        self.ddamping = np.array([float(name == "contact_damping") for name in names])
        self.drise = np.array([float(name == "floor_height") for name in names])
        self.viscous = scene.damping_time > 0 or "damping_time" in names
        self._moved = self.start().positions
        body, device = self.body, self.body.device
        cells = torch.as_tensor(body.space.samples.interior.cells, device=device)
        constants = (torch.as_tensor(c, device=device) for c in (body.youngs_modulus, body.poisson_ratio))
        self._dmu, self._dlam = (slope[cells] for slope in _lame_slopes(*constants))

    def _stiffest(self, name: str) -> bool:
        """Whether a parameter is the E from which default stiffnesses follow: the largest one."""
        stem, region = region_of(name)
        modulus = self.body.youngs_modulus * cells_of(self.body, region)
        return stem == "log10_youngs_modulus" and bool(modulus.max() == self.body.youngs_modulus.max())

    def _mass_of(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the mass matrix and of the first moments by a density."""
        region = region_of(name)[1]
        mean = mean_density(self.body, region)
        if region is None:
            return self.body.mass / mean, self.body.first_moments / mean
        mass, moments = self.body.space.mass_matrix(self.body.density * cells_of(self.body, region))
        return mass / mean, moments / mean

    def _moved_center(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the initial state by a density, which moves the centre of mass."""
        scene, space, (_, moments) = self.scene, self.body.space, self._heavier[name]
        one = space.affine(np.zeros((3, 3)), np.array([1.0, 0, 0]))[:, 0]
        center = self.body.first_moments @ scene.start / self.body.total_mass
        turn = rotation_matrix(np.asarray(scene.initial_orientation, dtype=np.float64))
        shift = turn.T @ (moments @ (scene.start - np.outer(one, center))) / self.body.total_mass
        spin = np.asarray(scene.initial_angular_velocity, dtype=np.float64)
        position = shift - turn @ shift
        return np.outer(one, position), np.outer(one, np.cross(spin, position - shift))

    def start(self) -> State:
        """Derivatives of the initial state, both of shape [P, R, 3]."""
        scene, space = self.scene, self.body.space
        positions = np.zeros((len(self.names), *scene.start.shape))
        velocities = positions.copy()
        center = self.body.first_moments @ scene.start / self.body.total_mass
        for i, name in enumerate(self.names):
            if name in self._heavier:
                positions[i], velocities[i] = self._moved_center(name)
            stem = name.rpartition("_")[0]
            if not stem.startswith("initial"):
                continue
            unit = np.eye(3)[axis_of(name)[1]]
            if stem == "initial_orientation":
                rate = turning_rates(np.asarray(scene.initial_orientation, dtype=np.float64)) @ unit
                positions[i] = np.cross(rate, scene.start) - space.affine(np.zeros((3, 3)), np.cross(rate, center))
                velocities[i] = np.cross(np.asarray(scene.initial_angular_velocity), positions[i])
            elif stem == "initial_position":
                positions[i] = space.affine(np.zeros((3, 3)), unit)
            elif stem == "initial_velocity":
                velocities[i] = space.affine(np.zeros((3, 3)), unit)
            else:
                shift = space.affine(np.zeros((3, 3)), np.cross(unit, center))
                velocities[i] = np.cross(unit, scene.start) - shift
        return State(0.0, positions, velocities)

    def freeze(
        self,
        y: Float[np.ndarray, "R 3"],
        v: Float[np.ndarray, "R 3"],
        time: float,
        dy: Float[np.ndarray, "P R 3"],
        dv: Float[np.ndarray, "P R 3"],
    ) -> FreezeTangent:
        """Friction frozen at coordinates y with velocities v, and its derivatives."""
        s = self.surface
        rates = self.dlog_stiffness, self.dfriction, self.ddamping, self.drise
        return FreezeTangent(s @ y, s @ v, time, s @ dy, s @ dv, *rates)

    def explicit(
        self, equations: ReducedEquations, c: StepCoefficients, x: Float[np.ndarray, "R 3"], state: Tensor | None
    ) -> Float[np.ndarray, "P R 3"]:
        """∂g/∂p of the step's gradient at fixed states and frozen friction.

        Every law is linear in μ and λ, contact in kc.

        Args:
            equations: of the step, for its time.
            c: its coefficients.
            x: coordinates at which the gradient is taken [m].
            state: F* of the viscosity; not needed without viscosity (`viscous`).
        """
        parts = [self._explicit(equations, name, c, x, state) for name in self.names]
        return np.array(parts).reshape(-1, *x.shape)

    def _viscous_forces(
        self, state: Tensor | None, velocity: np.ndarray, mu: Tensor, lam: Tensor, time: float
    ) -> Float[np.ndarray, "R 3"]:
        """Forces of the viscosities time × (μ, λ) [N]; none without a state."""
        if state is None or not self.viscous or time == 0:
            return np.zeros_like(self.scene.start)
        return self.body.viscous_gradient_with(state, velocity, time * mu, time * lam)

    def _explicit(
        self,
        equations: ReducedEquations,
        name: str,
        c: StepCoefficients,
        x: np.ndarray,
        state: Tensor | None,
    ) -> np.ndarray:
        body, scene, beta = self.body, self.scene, self.scene.damping_time
        velocity = c.velocity(x)
        stem, region = region_of(name)
        match stem:
            case "log10_youngs_modulus":
                mu, lam = self._within(region, body.mu, body.lam)
                plain = region is None and body.flow is None
                force = body.gradient(x) if plain else self._elastic_forces(x, mu, lam)
                force = force + self._viscous_forces(state, velocity, mu, lam, beta)
                if self._stiffest(name):
                    force += self._hold(equations, x)
                return _LN10 * force + self._stiffening(equations, name, x)
            case "log10_contact_stiffness":
                return self._stiffening(equations, name, x)
            case "poisson_ratio":
                mu, lam = self._within(region, self._dmu, self._dlam)
                return self._elastic_forces(x, mu, lam) + self._viscous_forces(state, velocity, mu, lam, beta)
            case "density":
                mass, moments = self._heavier[name]
                pull = (x - c.target) / c.step**2 + scene.air_drag * velocity
                return mass @ pull - moments[:, None] * scene.uniform_acceleration(equations.time)
            case "damping_time":
                return self._viscous_forces(state, velocity, body.mu, body.lam, 1.0)
            case "air_drag":
                return body.mass @ velocity
            case "gravity_x" | "gravity_y" | "gravity_z":
                return -body.first_moments[:, None] * np.eye(3)[axis_of(name)[1]]
            case "floor_height":
                return self.surface.T @ by_height_of_planes(equations.contact, self.surface @ x, equations.time)
            case "wind_x" | "wind_y" | "wind_z":
                pushed = equations.wind_blocks(velocity) @ np.eye(3)[axis_of(name)[1]]
                return -(self.surface.T @ pushed)
        if name.startswith(("initial_position", "initial_orientation")):
            return self._led(equations, name, x)
        return np.zeros_like(x)

    def _elastic_forces(self, x: np.ndarray, mu: Tensor, lam: Tensor) -> Float[np.ndarray, "R 3"]:
        """Forces of the law with other constants [N]."""
        if not self.body.law_acts:
            return np.zeros_like(x)
        return self.body.gradient_with(x, mu, lam)

    def lame_tangents(self) -> tuple[Tensor, Tensor]:
        """Derivatives of μ and λ at the samples [Pa], both of shape [P, Q]."""
        none, found = torch.zeros_like(self.body.mu), []
        for name in self.names:
            stem, region = region_of(name)
            if stem == "log10_youngs_modulus":
                found.append(self._within(region, _LN10 * self.body.mu, _LN10 * self.body.lam))
            elif stem == "poisson_ratio":
                found.append(self._within(region, self._dmu, self._dlam))
            else:
                found.append((none, none))
        return torch.stack([mu for mu, _ in found]), torch.stack([lam for _, lam in found])

    def _within(self, region: int | None, mu: Tensor, lam: Tensor) -> tuple[Tensor, Tensor]:
        """Constants of the samples of a region, zero elsewhere."""
        if region is None:
            return mu, lam
        here = torch.as_tensor(cells_of(self.body, region)[self.body.space.samples.interior.cells], device=mu.device)
        return mu * here, lam * here

    def _hold(self, equations: ReducedEquations, x: np.ndarray) -> np.ndarray:
        """Forces of pins whose stiffness follows E."""
        pins = self.scene.pins
        if equations.pins is None or pins is None or pins.stiffness is not None:
            return np.zeros_like(x)
        return equations.pins.energy_and_gradient(x, equations.time)[1]

    def _led(self, equations: ReducedEquations, name: str, x: np.ndarray) -> np.ndarray:
        """Derivative of the anchors of pins that hold the body at its start."""
        if equations.pins is None or equations.pins.motion is not None:
            return np.zeros_like(x)
        return -equations.pins.matrix @ self._moved[self.names.index(name)]

    def _stiffening(self, equations: ReducedEquations, name: str, x: np.ndarray) -> np.ndarray:
        rise = self.dlog_stiffness[self.names.index(name)]
        return rise * equations.touch.energy_and_gradient(x, equations.time)[1] if rise else np.zeros_like(x)
