"""What every body of one material has, in any discretisation: its law and flow at points that carry its volume."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.materials.combined_flows import stored_flows
from physconvex.materials.inelastic import FlowRule, FlowStep
from physconvex.materials.laws import Law, get_law, isotropic_stress, strain_rate


@dataclass(frozen=True)
class StepViscosity:
    """Kelvin–Voigt viscosity during a time step.

    Attributes:
        state: F* at which it is frozen, shape [E, Q, 3, 3].
        damping_time: viscosities over Lamé constants [s].
        step: derivative of positions by velocities [s].
    """

    state: Tensor
    damping_time: float
    step: float

    @property
    def ratio(self) -> float:
        """Damping time over the time step [-]."""
        return self.damping_time / self.step


class MaterialBody(ABC):
    """A law and a flow rule with their constants at points, of which a subclass knows F and the forces of stresses.

    Coordinates x [m], shape [N, 3], are the positions of nodes, or the coordinates of a reduced space.

    Args:
        law: the elastic law or its name.
        flow: flow rule of the material; purely elastic without it.
        device: where the arithmetic over the points runs.

    Attributes:
        mu, lam: Lamé constants at the points [Pa].
        rest: coordinates of the rest state [m].
    """

    rest: Float[np.ndarray, "N 3"]
    mu: Tensor
    lam: Tensor
    _weights: Tensor  # volumes of the points [m³]

    def __init__(self, law: str | Law, flow: FlowRule | None, device: str | torch.device) -> None:
        self.law = get_law(law) if isinstance(law, str) else law
        self.flow, self.device = flow, torch.device(device)

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.as_tensor(array, dtype=torch.float64, device=self.device)

    @abstractmethod
    def deformation_gradient(self, x: Float[np.ndarray, "*B N 3"]) -> Tensor:
        """F = ∂φ/∂X at the points for coordinates x [m], or Ḟ for velocities."""

    @abstractmethod
    def forces_of(self, stress: Tensor) -> Float[np.ndarray, "*B N 3"]:
        """Forces ∫ P : ∂F/∂x dV [N] of a stress field [Pa]."""

    @property
    def shear_scale(self) -> float:
        """∫ μ dV [J]: size of the terms that cancel each other in the elastic energy."""
        return float((self._weights * self.mu).sum())

    # -- elasticity and flow

    def energy(self, x: Float[np.ndarray, "N 3"], *, response: FlowStep | None = None) -> float:
        """Elastic energy [J]; with flow, the incremental one of a step.

        Args:
            x: coordinates [m].
            response: of the flow during a time step; without it, the instantaneous one from rest.
        """
        return self.energy_and_gradient(x, response=response)[0]

    def gradient(self, x: Float[np.ndarray, "N 3"], *, response: FlowStep | None = None) -> Float[np.ndarray, "N 3"]:
        """Derivative of the energy with respect to the coordinates [N] (minus the elastic force)."""
        return self.energy_and_gradient(x, response=response)[1]

    def energy_and_gradient(
        self, x: Float[np.ndarray, "N 3"], *, response: FlowStep | None = None
    ) -> tuple[float, Float[np.ndarray, "N 3"]]:
        """Both of the above with one evaluation of F."""
        f = self.deformation_gradient(x)
        energy = float((self._weights * self._material("energy", f, response)).sum())
        return energy, self.forces_of(self._material("stress", f, response))

    def stress(self, x: Float[np.ndarray, "N 3"]) -> Tensor:
        """First Piola–Kirchhoff stress at the points [Pa]."""
        return self._material("stress", self.deformation_gradient(x), None)

    def _material(self, of: Literal["energy", "stress", "hessian"], f: Tensor, response: FlowStep | None) -> Tensor:
        """Energy density, stress or Hessian at the points: of the law, the flow, or both."""
        parts: list[Tensor] = []
        if self.law_acts:
            parts.append(getattr(self.law, of)(f, self.mu, self.lam))
        if (flowing := self._flowing(response)) is not None:
            parts.append(getattr(flowing, of)(f))
        return sum(parts[1:], parts[0])

    @property
    def law_acts(self) -> bool:
        """Whether no flow rule replaces the elastic law."""
        return self.flow is None or self.flow.beside_law

    def _flowing(self, response: FlowStep | None) -> FlowStep | None:
        """The flow response; by default the instantaneous one without any flow; None for an elastic body."""
        return self._virgin if response is None else response

    @cached_property
    def _virgin(self) -> FlowStep | None:
        return None if self.flow is None else self.flow_step(self.unflowed(), self.rest, 0.0)

    def unflowed(self) -> Tensor:
        """F_f⁻¹ without any flow, shape [..., 3, 3], of `Flows` [..., 2, 3, 3]."""
        shape = (*self._weights.shape, *stored_flows(self.flow), 3, 3)
        return torch.eye(3, dtype=torch.float64, device=self.device).expand(shape)

    def flow_step(self, undo: Tensor, x: Float[np.ndarray, "N 3"], step: float) -> FlowStep:
        """Response of the flowing part during a step [s], from F_f⁻¹ at its start; lagged terms are taken at x [m]."""
        assert self.flow is not None
        return self.flow.during(undo, self.deformation_gradient(x), self.mu, self.lam, step)

    # -- viscosity, see `physconvex.materials.laws`

    def viscous_energy_and_gradient(
        self, state: Tensor, velocity: Float[np.ndarray, "N 3"], damping_time: float
    ) -> tuple[float, Float[np.ndarray, "N 3"]]:
        """Rate potential [W] and its derivative by velocity [N] for viscosity damping_time × (μ, λ), frozen at F*."""
        strain, inner = self._viscous_pair(state, self.deformation_gradient(velocity), damping_time)
        return self._rate_potential(strain, inner), self.forces_of(state @ inner)

    def _viscous_pair(self, state: Tensor, rate: Tensor, damping_time: float) -> tuple[Tensor, Tensor]:
        """Ė, and 2 μ_v Ė + λ_v tr Ė."""
        strain = strain_rate(state, rate)
        return strain, isotropic_stress(strain, damping_time * self.mu, damping_time * self.lam)

    def _rate_potential(self, strain: Tensor, inner: Tensor) -> float:
        return 0.5 * float((self._weights * (inner * strain).sum((-1, -2))).sum())
