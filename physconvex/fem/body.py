"""A hyperelastic body on a tetrahedral mesh: energy, forces, stiffness, mass, viscosity."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.fem.assembly import scalar_matrix
from physconvex.fem.compiled_elements import CompiledElements, compiled_elements
from physconvex.materials import (
    FlowRule,
    FlowStep,
    Law,
    MaterialBody,
    MaterialPoints,
    StepViscosity,
    checked_constant,
    lame_parameters,
    project_to_positive,
    strain_stiffness,
)
from physconvex.mesh import QUADRATURE, TetMesh, barycentric_gradients, shape_gradients, unit_mass

PerElement = float | Float[np.ndarray, " E"]
PerPoint = PerElement | Float[np.ndarray, "E Q"]


class ElasticBody(MaterialBody):
    """Tetrahedral body with one elastic law and constants per element.

    Args:
        mesh: linear or quadratic mesh, rest state.
        law: the elastic law or its name, see `physconvex.materials.laws` and `physconvex.materials.strain_terms`.
        youngs_modulus: E [Pa], scalar, [E], or [E, Q] at `quadrature_points`, where it varies within an element.
        poisson_ratio: ν [-], scalar or [E], in (-1, 0.5).
        density: ρ [kg/m³], scalar or [E].
        flow: flow rule of the material, see `physconvex.materials.inelastic`; purely elastic unless given.
        device: where element arithmetic runs (the sparse solve stays on the CPU).

    Raises:
        InputError: a constant out of its range or of the wrong shape.
    """

    def __init__(
        self,
        mesh: TetMesh,
        *,
        law: str | Law = "neo_hookean",
        youngs_modulus: PerPoint = 1e5,
        poisson_ratio: PerElement = 0.4,
        density: PerElement = 1000.0,
        flow: FlowRule | None = None,
        device: str | torch.device = "cpu",
    ) -> None:
        super().__init__(law, flow, device)
        self.mesh, self.rest = mesh, mesh.vertices
        self._barycentric, volumes = _rule(mesh)
        each = (len(mesh.tets),)
        modulus_shape = volumes.shape if np.ndim(youngs_modulus) == 2 else each
        self.youngs_modulus = checked_constant("youngs_modulus", youngs_modulus, modulus_shape)
        self.poisson_ratio = checked_constant("poisson_ratio", poisson_ratio, each)
        self.density = checked_constant("density", density, each)
        self._weights = self._tensor(volumes)  # [E, Q]
        ratio = self._tensor(self.poisson_ratio)[:, None]
        self.mu, self.lam = lame_parameters(self._tensor(self.modulus_at_points), ratio)  # [E, Q]
        self._gradients = self._tensor(self._rest_gradients())  # [E, Q, n, 3]
        count, points, nodes, _ = self._gradients.shape
        self._flat_gradients = self._gradients.transpose(1, 2).reshape(count, nodes, points * 3).contiguous()
        self._tets = torch.as_tensor(mesh.tets, device=self.device)
        self._quick: CompiledElements | None = None
        if flow is None and self.device.type == "cpu":
            arrays = (t.numpy() for t in (self._gradients, self._weights, self.mu, self.lam))
            self._quick = compiled_elements(self.law, mesh.tets, MaterialPoints(*arrays))

    # -- set-up

    def _rest_gradients(self) -> np.ndarray:
        """∂N/∂X at the quadrature points, [E, Q, n, 3]; straight-edged elements have constant ∂b/∂X."""
        barycentric = barycentric_gradients(self.mesh.vertices[self.mesh.corner_tets])
        shapes = shape_gradients(self._barycentric.reshape(-1, 4), self.mesh.order)
        return np.einsum("eqnb,ebi->eqni", shapes.reshape(*self._barycentric.shape[:2], -1, 4), barycentric)

    @property
    def quadrature_points(self) -> Float[np.ndarray, "E Q 3"]:
        """Points at which the law is evaluated [m], at rest."""
        return np.asarray(self._barycentric @ self.mesh.vertices[self.mesh.corner_tets])

    @property
    def modulus_at_points(self) -> Float[np.ndarray, "E Q"]:
        """E at the quadrature points [Pa]."""
        modulus = self.youngs_modulus.reshape(len(self.mesh.tets), -1)
        return np.repeat(modulus, self._weights.shape[1] // modulus.shape[1], axis=1)

    @cached_property
    def mass(self) -> sp.csr_matrix:
        """Mass matrix of one coordinate [kg], shape [V, V]: consistent, or of the mesh's particles."""
        if self.mesh.mass_shares is not None:
            return sp.diags(self.total_mass * self.mesh.mass_shares).tocsr()
        mesh = self.mesh
        if mesh.filling is None:
            blocks = (self.density * mesh.element_volumes)[:, None, None] * unit_mass(mesh.order)
        else:
            blocks = self.density[:, None, None] * mesh.filling.mass
        return scalar_matrix(mesh.tets, blocks, len(mesh.vertices))

    @property
    def total_mass(self) -> float:
        """Mass of the body [kg]."""
        part = self.mesh.filling
        volumes = self.mesh.element_volumes if part is None else part.weights.sum(axis=1)
        return float((self.density * volumes).sum())

    @cached_property
    def node_masses(self) -> Float[np.ndarray, " V"]:
        """Row sums of the mass matrix [kg]: the weights of a uniform acceleration."""
        return np.asarray(self.mass.sum(axis=1)).ravel()

    # -- elasticity

    def deformation_gradient(self, x: Float[np.ndarray, "V 3"]) -> Tensor:
        """F = ∂x/∂X at the quadrature points, shape [E, Q, 3, 3]."""
        flat = self._tensor(x)[self._tets].mT @ self._flat_gradients  # [E, 3, Q·3]
        return flat.reshape(len(self._tets), 3, -1, 3).transpose(1, 2)

    def energy_and_gradient(
        self, x: Float[np.ndarray, "V 3"], *, response: FlowStep | None = None
    ) -> tuple[float, Float[np.ndarray, "V 3"]]:
        """Energy [J] and its derivative [N], see `energy` and `gradient`."""
        if self._quick is not None:
            return self._quick.energy_and_gradient(x)
        return super().energy_and_gradient(x, response=response)

    def forces_of(self, stress: Tensor) -> Float[np.ndarray, "V 3"]:
        """Forces on the nodes ∫ P : ∂N_a/∂X dV [N] of a stress field [Pa], shape [E, Q, 3, 3]."""
        weighted = self._weights[..., None, None] * stress
        flat = weighted.transpose(2, 3).reshape(len(self._tets), -1, 3)  # [E, Q·3 (j), 3 (i)]
        forces = self._flat_gradients @ flat
        out = torch.zeros(len(self.mesh.vertices), 3, dtype=torch.float64, device=self.device)
        return out.index_add_(0, self._tets.reshape(-1), forces.reshape(-1, 3)).cpu().numpy()

    def element_hessians(
        self,
        x: Float[np.ndarray, "V 3"],
        *,
        project: bool = False,
        viscosity: StepViscosity | None = None,
        response: FlowStep | None = None,
        out: Float[np.ndarray, "E m m"] | None = None,
    ) -> Float[np.ndarray, "E m m"]:
        """Element stiffness matrices [N/m], m = 3 × nodes, degrees of freedom ordered node by node.

        Args:
            x: node positions [m].
            project: set negative eigenvalues of ∂P/∂F to zero first.
            viscosity: of a time step, whose stiffness is then added.
            response: as for the energy.
            out: an array for the result, since allocating memory costs more than the arithmetic.
        """
        if self._quick is not None and not project:
            quick = self._quick.stiffness(x, viscosity=viscosity, out=out)
            if quick is not None:
                return quick
        hessian = self._material("hessian", self.deformation_gradient(x), response)
        if project:
            hessian = project_to_positive(hessian)
        if viscosity is not None:
            mu, lam = viscosity.ratio * self.mu, viscosity.ratio * self.lam
            hessian = hessian + strain_stiffness(viscosity.state, mu, lam)
        return self._integrate(hessian)

    def _integrate(self, tensor: Tensor) -> np.ndarray:
        """Σ_q w ∂N_a/∂X_j A_ijkl ∂N_b/∂X_l, shape [E, 3n, 3n]."""
        count, points, nodes, _ = self._gradients.shape
        a = (self._weights[..., None, None] * tensor).reshape(count, points, 3, 3, 3, 3)
        half = self._gradients @ a.permute(0, 1, 3, 2, 4, 5).reshape(count, points, 3, 27)  # [E, Q, a, (i k l)]
        half = half.reshape(count, points, nodes * 9, 3).transpose(1, 2).reshape(count, nodes * 9, points * 3)
        full = (half @ self._flat_gradients.mT).reshape(count, nodes, 3, 3, nodes)  # [E, a, i, k, b]
        return full.permute(0, 1, 2, 4, 3).reshape(count, nodes * 3, nodes * 3).cpu().numpy()

    def moving_energy_and_gradient(
        self,
        x: Float[np.ndarray, "V 3"],
        velocity: Float[np.ndarray, "V 3"],
        viscosity: StepViscosity,
        *,
        response: FlowStep | None = None,
        with_energy: bool = True,
    ) -> tuple[float, Float[np.ndarray, "V 3"]]:
        """Elastic energy plus step [s] times the viscous rate potential, and elastic plus viscous forces, in one pass.

        Args:
            x, velocity: of the nodes [m, m/s].
            viscosity: of the step.
            response: as for the energy.
            with_energy: compute the energy, which is NaN otherwise.
        """
        if self._quick is not None:
            return self._quick.moving_energy_and_gradient(x, velocity, viscosity, with_energy=with_energy)
        moving = torch.cat([self._tensor(x), self._tensor(velocity)], dim=1)[self._tets]
        both = (moving.mT @ self._flat_gradients).reshape(len(self._tets), 2, 3, -1, 3).transpose(2, 3)
        f, rate = both[:, 0], both[:, 1]
        strain, inner = self._viscous_pair(viscosity.state, rate, viscosity.damping_time)
        gradient = self.forces_of(self._material("stress", f, response) + viscosity.state @ inner)
        if not with_energy:
            return float("nan"), gradient
        elastic = float((self._weights * self._material("energy", f, response)).sum())
        return elastic + viscosity.step * self._rate_potential(strain, inner), gradient


def _rule(mesh: TetMesh) -> tuple[Float[np.ndarray, "E Q 4"], Float[np.ndarray, "E Q"]]:
    """Barycentric coordinates of the points at which the law is evaluated, and the volume of each [m³]."""
    if mesh.filling is not None:
        return mesh.filling.barycentric, mesh.filling.weights
    barycentric, weights = QUADRATURE[1 if mesh.order == 1 else 2]
    return np.broadcast_to(barycentric, (len(mesh.tets), *barycentric.shape)), mesh.element_volumes[:, None] * weights
