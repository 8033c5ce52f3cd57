"""An elastic or inelastic body in a reduced space: energy, forces, dense Hessian, mass, viscosity."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from physconvex.errors import InputError
from physconvex.materials import (
    FlowRule,
    FlowStep,
    Law,
    MaterialBody,
    MaterialPoints,
    checked_constant,
    isotropic_stress,
    lame_parameters,
    project_to_positive,
    strain_rate,
    strain_stiffness,
    viscous_stress,
)
from physconvex.reduced.compiled_body import CompiledViscosity, compiled_viscosity, volumetric_samples
from physconvex.reduced.space import ReducedSpace
from physconvex.reduced.volumetric import VolumetricSamples

PerCell = float | Float[np.ndarray, " C"]
_BLOCK = 4_000_000  # numbers in the largest temporary of the Hessian
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class ReducedBody(MaterialBody):
    """A reduced space filled with one elastic law; constants per cell of the samples (per tetrahedron).

    Args:
        space: shape functions and samples.
        law: the elastic law or its name, see `physconvex.materials.laws` and `physconvex.materials.strain_terms`.
        youngs_modulus: E [Pa], scalar or [C].
        poisson_ratio: ν [-], scalar or [C], in (-1, 0.5).
        density: ρ [kg/m³], scalar or [C].
        regions: number of each cell's region, [C], 0 to K − 1: E, ν and ρ of a region are then parameters of a scene,
            for example `poisson_ratio[0]`.
        flow: flow rule of the material, see `FlowRule`; purely elastic unless given. `Plasticine` and `Sand` replace
            `law`, `StandardLinearSolid` adds to it.
        device: where the arithmetic over the samples runs (the dense solve stays on the CPU).

    Attributes:
        mass: mass matrix of one coordinate [kg], shape [R, R].
        first_moments: ∫ ρ N_a dV [kg], shape [R]: the weights of a uniform acceleration.

    Raises:
        InputError: a constant out of its range or of the wrong shape.
    """

    def __init__(
        self,
        space: ReducedSpace,
        *,
        law: str | Law = "neo_hookean",
        youngs_modulus: PerCell = 1e5,
        poisson_ratio: PerCell = 0.4,
        density: PerCell = 1000.0,
        flow: FlowRule | None = None,
        device: str | torch.device = "cpu",
        regions: Int[np.ndarray, " C"] | None = None,
    ) -> None:
        super().__init__(law, flow, device)
        self.space, self.rest = space, space.rest
        cells = (space.samples.interior.cell_count,)
        self.youngs_modulus = checked_constant("youngs_modulus", youngs_modulus, cells)
        self.poisson_ratio = checked_constant("poisson_ratio", poisson_ratio, cells)
        self.density = checked_constant("density", density, cells)
        self.regions = None if regions is None else self._checked_regions(regions)
        interior = space.samples.interior
        self.mu, self.lam = (
            constant[torch.as_tensor(interior.cells, device=self.device)]
            for constant in lame_parameters(self._tensor(self.youngs_modulus), self._tensor(self.poisson_ratio))
        )
        self._weights = self._tensor(interior.weights)
        flat = space.interior_gradients.transpose(0, 2, 1).reshape(-1, space.dimension)
        self._gradients = self._tensor(np.ascontiguousarray(flat))  # [(Q, j), R]
        self._quick: VolumetricSamples | None = None  # of the law alone, also if there is a flow besides it
        if self.law_acts and self.device.type == "cpu" and self.law.volumetric is not None:
            self._quick = volumetric_samples(self.law, self._samples)
        self.mass, self.first_moments = space.mass_matrix(self.density)

    def with_material(self, **constants: PerCell) -> ReducedBody:
        """The same body with other constants `youngs_modulus`, `poisson_ratio` or `density`; the space is shared."""
        return self._changed(**constants)

    def with_flow(self, flow: FlowRule | None) -> ReducedBody:
        """The same body with another flow rule; the space is shared."""
        return self._changed(flow=flow)

    def with_space(self, space: ReducedSpace) -> ReducedBody:
        """The same material with other skinning weights, sampled over the same cells."""
        return self._changed(space=space)

    def _changed(self, **changes: Any) -> ReducedBody:
        kept = ("space", "law", "youngs_modulus", "poisson_ratio", "density", "flow", "device", "regions")
        return ReducedBody(**({name: getattr(self, name) for name in kept} | changes))

    # -- set-up

    def _checked_regions(self, regions: np.ndarray) -> np.ndarray:
        array, count = np.asarray(regions), self.space.samples.interior.cell_count
        if (
            array.shape != (count,)
            or array.dtype.kind not in "iu"
            or set(array.tolist()) != set(range(array.max() + 1))
        ):
            raise InputError(
                f"regions: got {array.dtype} of shape {array.shape}; expected whole numbers of shape [{count}], one "
                "per cell, from 0 without a gap"
            )
        return array

    @property
    def _samples(self) -> MaterialPoints:
        flat, *constants = (t.cpu().numpy() for t in (self._gradients, self._weights, self.mu, self.lam))
        return MaterialPoints(flat.reshape(-1, 3, self.space.dimension), *constants)

    @cached_property
    def _viscosity(self) -> CompiledViscosity | None:
        return compiled_viscosity(self._samples) if self.device.type == "cpu" else None

    @property
    def volume(self) -> float:
        """Volume of the body [m³]."""
        return self.space.samples.mass.volume

    @property
    def total_mass(self) -> float:
        """Mass of the body [kg]."""
        mass = self.space.samples.mass
        return float(mass.weights @ self.density[mass.cells])

    # -- elasticity

    def deformation_gradient(self, y: Float[np.ndarray, "*B R 3"]) -> Tensor:
        """F = ∂φ/∂X at the interior samples for coordinates y [m] (or Ḟ for velocities), shape [..., Q, 3, 3]."""
        columns = self._gradients @ self._tensor(y)  # [..., (Q, j), i]
        return columns.reshape(*columns.shape[:-2], -1, 3, 3).mT

    def forces_of(self, stress: Tensor) -> Float[np.ndarray, "*B R 3"]:
        """Generalised forces ∫ P : ∂N_a/∂X dV [N] of a stress field [Pa], shape [..., Q, 3, 3]."""
        weighted = (self._weights[:, None, None] * stress).mT  # [..., Q, j, i]
        return (self._gradients.mT @ weighted.reshape(*stress.shape[:-3], -1, 3)).cpu().numpy()

    def energy_and_gradient(
        self, y: Float[np.ndarray, "R 3"], *, response: FlowStep | None = None
    ) -> tuple[float, Float[np.ndarray, "R 3"]]:
        """Energy [J] and its derivative [N], see `energy` and `gradient`."""
        if self._quick is None:
            return super().energy_and_gradient(y, response=response)
        energy, forces = self._quick.energy_and_gradient(y)
        if (flowing := self._flowing(response)) is not None:
            f = self.deformation_gradient(y)
            energy += float((self._weights * flowing.energy(f)).sum())
            forces = forces + self.forces_of(flowing.stress(f))
        return energy, forces

    def gradient_with(self, y: Float[np.ndarray, "R 3"], mu: Tensor, lam: Tensor) -> Float[np.ndarray, "R 3"]:
        """The derivative [N] with other constants μ and λ of the elastic law [Pa], shape [Q]."""
        if self._quick is not None:
            return self._quick.energy_and_gradient(y, (mu.numpy(), lam.numpy()))[1]
        return self.forces_of(self.law.stress(self.deformation_gradient(y), mu, lam))

    def hessian(self, y: Float[np.ndarray, "R 3"], *, project: bool = False) -> Float[np.ndarray, "N N"]:
        """Dense stiffness matrix without viscosity [N/m], N = 3 R, ordered function by function.

        Args:
            y: coordinates [m].
            project: set negative eigenvalues of ∂P/∂F to zero first.
        """
        return function_by_function(self.stiffness_blocks(y, project=project))

    def stiffness_blocks(
        self, y: Float[np.ndarray, "R 3"], *, project: bool = False, response: FlowStep | None = None
    ) -> Float[np.ndarray, "3 R 3 R"]:
        """The stiffness matrix without viscosity [N/m], components first."""
        if self._quick is not None and not project:
            blocks = self._quick.hessian_blocks(y)
            if blocks is not None and (flowing := self._flowing(response)) is not None:
                blocks += self._integrate(flowing.hessian(self.deformation_gradient(y)))
            if blocks is not None:
                return blocks
        tensor = self._material("hessian", self.deformation_gradient(y), response)
        return self._integrate(project_to_positive(tensor) if project else tensor)

    def viscous_blocks(self, viscous_state: Tensor, damping_ratio: float) -> Float[np.ndarray, "3 R 3 R"]:
        """Stiffness of the viscosity of a time step [N/m], components first; it does not depend on the coordinates."""
        if self._viscosity is not None:
            return self._viscosity.blocks(viscous_state.numpy(), damping_ratio)
        return self._integrate(strain_stiffness(viscous_state, damping_ratio * self.mu, damping_ratio * self.lam))

    def _integrate(self, tensor: Tensor) -> np.ndarray:
        """Σ_q w ∂N_a/∂X_j A_ijkl ∂N_b/∂X_l, shape [3, R, 3, R]; A_ijkl = A_klij, so that i ≤ k is enough."""
        size = self.space.dimension
        parts = torch.zeros(size, 6 * size, dtype=torch.float64, device=self.device)  # b, (pair, a)
        gradients = self._gradients.reshape(-1, 3, size)  # [Q, j, R]
        a = (self._weights[:, None, None] * tensor).reshape(-1, 3, 3, 3, 3)
        pairs = torch.stack([a[:, i, :, k, :].mT for i, k in _PAIRS], dim=2)  # [Q, l, pair, j]
        for g, block in zip(*(t.split(max(_BLOCK // (18 * size), 1)) for t in (gradients, pairs)), strict=True):
            half = block.reshape(len(g), 18, 3) @ g  # [Q, (l, pair), a]: this order needs no transposition
            parts += g.reshape(-1, size).mT @ half.reshape(-1, 6 * size)
        return _from_pairs(parts.reshape(size, 6, size)).cpu().numpy()

    # -- viscosity, see `physconvex.materials.laws`

    def viscous_energy_and_gradient(
        self, state: Tensor, velocity: Float[np.ndarray, "R 3"], damping_time: float
    ) -> tuple[float, Float[np.ndarray, "R 3"]]:
        """Rate potential [W] and its derivative with respect to velocity [N] for viscosity damping_time × (μ, λ)."""
        if self._viscosity is not None:
            return self._viscosity.energy_and_gradient(state.numpy(), velocity, damping_time)
        return super().viscous_energy_and_gradient(state, velocity, damping_time)

    def viscous_gradient_with(
        self, state: Tensor, velocity: Float[np.ndarray, "R 3"], mu: Tensor, lam: Tensor
    ) -> Float[np.ndarray, "R 3"]:
        """The derivative [N] for other viscosities μ_v and λ_v [Pa·s], shape [Q]."""
        if self._viscosity is not None:
            return self._viscosity.energy_and_gradient(state.numpy(), velocity, 1.0, (mu.numpy(), lam.numpy()))[1]
        return self.forces_of(viscous_stress(state, self.deformation_gradient(velocity), mu, lam))

    def viscous_tangent(
        self,
        state: Tensor,
        velocity: Float[np.ndarray, "R 3"],
        step: Float[np.ndarray, "R 3"],
        speed_up: Float[np.ndarray, "R 3"],
        damping_time: float,
    ) -> Float[np.ndarray, "R 3"]:
        """Derivative of the viscous forces: `step` changes the coordinates in F*, `speed_up` the velocity."""
        if self._viscosity is not None:
            return self._viscosity.tangent(state.numpy(), velocity, step, speed_up, damping_time)
        mu, lam = damping_time * self.mu, damping_time * self.lam
        rate, moved, faster = (self.deformation_gradient(y) for y in (velocity, step, speed_up))
        change = isotropic_stress(strain_rate(moved, rate), mu, lam)
        change = change + isotropic_stress(strain_rate(state, faster), mu, lam)
        return self.forces_of(moved @ isotropic_stress(strain_rate(state, rate), mu, lam) + state @ change)


def _from_pairs(parts: Tensor) -> Tensor:
    """The symmetric [3, R, 3, R] array from its blocks (i, k), i ≤ k, given as [b, pair, a]."""
    size = parts.shape[0]
    out = torch.empty(3, size, 3, size, dtype=parts.dtype, device=parts.device)
    for number, (i, k) in enumerate(_PAIRS):
        out[i, :, k] = parts[:, number].mT
        out[k, :, i] = parts[:, number]
    return out


def function_by_function(blocks: Float[np.ndarray, "3 R 3 R"]) -> Float[np.ndarray, "N N"]:
    """The matrix [3R, 3R], rows ordered by shape function, then component."""
    size = 3 * blocks.shape[1]
    return blocks.transpose(1, 0, 3, 2).reshape(size, size)
