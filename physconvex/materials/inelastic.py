"""Materials with memory: plasticine, sand, and the standard linear solid, with a stored flow deformation per point.

The deformation is split multiplicatively, F = F_e F_f. The flow F_f (volume-preserving) is stored. With the trial F_e =
F F_f⁻¹ of a time step, its logarithmic principal strains ε, their deviator d, r = |d| and trace t, the step minimises
the incremental potential (Ortiz & Stainier 1999)

    W(ε) = m r²  up to  2 m r = k,   k r − k²/(4 m)  beyond,   plus  K t²/2,       m = s μ,

whose stress is the one at the *end* of the step: radial return in logarithmic strains (Simo 1992). k limits the
deviatoric Kirchhoff stress |dev τ|, s is the share that relaxation leaves. The second derivative is exact (the
algorithmic tangent); if it is indefinite, Newton's method uses its positive part. After the step the deviator of F_e is
min(s, k/(2 μ r)) d, the remainder is added to F_f.

As r → 0 all of them are Hencky's law, linear elasticity with E and ν at F = I. Plasticine may use a neo-Hookean law
instead, see `physconvex.materials.yielding`: a body below its yield stress is then purely neo-Hookean.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from physconvex.errors import InputError
from physconvex.materials.laws import get_law
from physconvex.materials.principal_strains import (
    PrincipalFrame,
    flow_response,
    principal_hessian,
    principal_stress,
    pulled_back,
)
from physconvex.materials.volumetric import KERNEL_LAWS
from physconvex.materials.yielding import YieldStep

Strains = tuple[PrincipalFrame, Tensor, Tensor, Tensor]  # frame of F_e; t, d and r
Response = tuple[Tensor, Tensor] | None  # energy and stress
_TINY = 1e-100  # its square is a number still


@runtime_checkable
class FlowStep(Protocol):
    """Response of a material during one time step, from the flow at its start."""

    @property
    def undo(self) -> Tensor:
        """F_f⁻¹ at the start of the step, shape [Q, 3, 3]."""

    def energy(self, f: Tensor) -> Tensor:
        """W [J/m³], shape [Q]; infinite where det F ≤ 0."""

    def stress(self, f: Tensor) -> Tensor:
        """First Piola–Kirchhoff stress ∂W/∂F [Pa], shape [Q, 3, 3]."""

    def hessian(self, f: Tensor) -> Tensor:
        """∂P/∂F [Pa], shape [Q, 9, 9], F flattened row by row."""

    def flowed(self, f: Tensor) -> Tensor:
        """F_f⁻¹ at the end of the step, shape [Q, 3, 3]."""


@dataclass(frozen=True)
class LogarithmicStep:
    """Response in logarithmic strains during one time step, see `FlowStep`.

    Attributes:
        undo: F_f⁻¹ at the start of the step, shape [Q, 3, 3].
        mu: μ [Pa], shape [Q].
        bulk: K [Pa], shape [Q].
        limit: k [Pa], shape [Q]; infinite where nothing yields.
        left: s, the share of the deviatoric strain that relaxation leaves at the end of the step.
        tension: whether the material resists tension; if not, W is zero where t > 0.
    """

    undo: Tensor
    mu: Tensor
    bulk: Tensor
    limit: Tensor
    left: float
    tension: bool
    _last: list[tuple[Tensor, Strains]] = field(default_factory=list, init=False, repr=False, compare=False)
    _compiled: list[tuple[Tensor, Response]] = field(default_factory=list, init=False, repr=False, compare=False)

    def _response(self, f: Tensor) -> Response:
        """Energy and stress by compiled arithmetic, if available; kept, since both are requested."""
        if not self._compiled or self._compiled[0][0] is not f:
            constants = (self.mu, self.bulk, self.limit)
            found = flow_response(f, self.undo, *constants, left=self.left, tension=self.tension)
            self._compiled[:] = [(f, found)]
        return self._compiled[0][1]

    def _frame(self, f: Tensor) -> Strains:
        """Strains of the trial F_e; kept, since energy and stress are requested at the same F."""
        if self._last and self._last[0][0] is f:
            return self._last[0][1]
        frame = PrincipalFrame.of(f @ self.undo)
        strain = frame.strains
        trace = strain.sum(-1)
        deviator = strain - trace.unsqueeze(-1) / 3
        found = frame, trace, deviator, torch.linalg.vector_norm(deviator, dim=-1)
        self._last[:] = [(f, found)]
        return found

    def _limit(self, trace: Tensor) -> Tensor:
        return self.limit if self.tension else torch.where(trace > 0, 0.0, self.limit)

    def _yields(self, limit: Tensor, radius: Tensor) -> Tensor:
        return 2 * self.left * self.mu * radius >= limit

    def _pressing(self, trace: Tensor) -> Tensor:
        """The trace that is resisted."""
        return trace if self.tension else trace.clamp_max(0.0)

    def energy(self, f: Tensor) -> Tensor:
        """W [J/m³], shape [Q]; infinite where det F ≤ 0."""
        if (quick := self._response(f)) is not None:
            return quick[0]
        frame, trace, _, radius = self._frame(f)
        m, limit = self.left * self.mu, self._limit(trace)
        flowing = limit * radius - limit**2 / (4 * m)
        shear = torch.where(self._yields(limit, radius), torch.nan_to_num(flowing), m * radius**2)
        energy = shear + self.bulk / 2 * self._pressing(trace) ** 2
        return torch.where(frame.proper, energy, torch.inf)

    def _slopes(self, trace: Tensor, deviator: Tensor, radius: Tensor) -> tuple[Tensor, Tensor]:
        """Principal Kirchhoff stresses, and g'/r of the deviatoric part."""
        limit = self._limit(trace)
        secant = torch.where(self._yields(limit, radius), limit / radius.clamp_min(_TINY), 2 * self.left * self.mu)
        return secant.unsqueeze(-1) * deviator + (self.bulk * self._pressing(trace)).unsqueeze(-1), secant

    def stress(self, f: Tensor) -> Tensor:
        """First Piola–Kirchhoff stress ∂W/∂F [Pa], shape [Q, 3, 3]."""
        if (quick := self._response(f)) is not None:
            return quick[1]
        frame, trace, deviator, radius = self._frame(f)
        return principal_stress(frame, self._slopes(trace, deviator, radius)[0]) @ self.undo.mT

    def hessian(self, f: Tensor) -> Tensor:
        """∂P/∂F [Pa], shape [Q, 9, 9], F flattened row by row."""
        frame, trace, deviator, radius = self._frame(f)
        slopes, secant = self._slopes(trace, deviator, radius)
        limit, eye = self._limit(trace), torch.eye(3).to(f)
        # g'' is zero where the material flows, and equals g'/r where it does not
        radial = torch.where(self._yields(limit, radius), secant / radius.clamp_min(_TINY) ** 2, 0.0)
        stiff = self.bulk if self.tension else torch.where(trace < 0, self.bulk, 0.0)
        curvature = secant[..., None, None] * (eye - 1 / 3) + stiff[..., None, None]
        curvature = curvature - radial[..., None, None] * deviator.unsqueeze(-1) * deviator.unsqueeze(-2)
        return pulled_back(principal_hessian(frame, slopes, curvature), self.undo)

    def flowed(self, f: Tensor) -> Tensor:
        """F_f⁻¹ at the end of the step, shape [Q, 3, 3]."""
        frame, trace, deviator, radius = self._frame(f)
        limit = self._limit(trace)
        share = torch.minimum(limit / (2 * self.mu * radius).clamp_min(_TINY), torch.full_like(radius, self.left))
        back = ((share - 1).unsqueeze(-1) * deviator).exp()
        return self.undo @ (frame.vt.mT * back.unsqueeze(-2)) @ frame.vt


@runtime_checkable
class FlowRule(Protocol):
    """How a material flows."""

    @property
    def beside_law(self) -> bool:
        """Whether the flowing part adds to the body's elastic law, or replaces it."""

    @property
    def lagged(self) -> bool:
        """Whether the response depends on a state that is unknown before the step is solved (it needs passes)."""

    def during(self, undo: Tensor, state: Tensor, mu: Tensor, lam: Tensor, step: float) -> FlowStep:
        """The response during one step.

        Args:
            undo: F_f⁻¹ at its start, [Q, 3, 3].
            state: F for the lagged terms, [Q, 3, 3].
            mu, lam: Lamé constants of the body [Pa], [Q].
            step: length of the step [s].
        """


def _bulk(mu: Tensor, lam: Tensor) -> Tensor:
    return lam + 2 / 3 * mu


@dataclass(frozen=True)
class Plasticine:
    """Perfect plasticity of von Mises: shear strain beyond the yield stress remains.

    Attributes:
        yield_stress: τ_Y [Pa], the stress at which a pulled bar yields (|dev τ| ≤ √(2/3) τ_Y, Kirchhoff stress);
            in shear it is τ_Y/√3.
        elastic: law below the yield stress: "hencky", or a neo-Hookean law by name, see `physconvex.materials.laws`.

    Raises:
        InputError: not a number > 0, or another law.
    """

    yield_stress: float
    elastic: str = "hencky"
    beside_law: bool = False
    lagged: bool = False

    def __post_init__(self) -> None:
        if not (np.isfinite(self.yield_stress) and self.yield_stress > 0):
            raise InputError(f"yield_stress: got {self.yield_stress}; expected a finite number > 0 in Pa")
        if self.elastic not in ("hencky", *KERNEL_LAWS):
            raise InputError(f"elastic: got {self.elastic!r}; expected hencky or one of {', '.join(KERNEL_LAWS)}")

    def during(self, undo: Tensor, state: Tensor, mu: Tensor, lam: Tensor, step: float) -> FlowStep:
        """The response during one step, see `FlowRule`."""
        limit = torch.full_like(mu, float(np.sqrt(2 / 3)) * self.yield_stress)
        if self.elastic != "hencky":
            return YieldStep(undo, mu, lam, limit, get_law(self.elastic))
        return LogarithmicStep(undo, mu, _bulk(mu, lam), limit, 1.0, tension=True)


@dataclass(frozen=True)
class Sand:
    """Drucker–Prager without cohesion (Klár et al. 2016, without hardening): pressure limits the shear stress.

    |dev τ| ≤ √(2/3) M p with p = −K t and M = 6 sin φ/(3 − sin φ), which agrees with Mohr–Coulomb in triaxial
    compression. No tension; an opened material resists again after closing by the same amount. Flow keeps the volume,
    so that the stress has no potential: like friction, the limit takes its pressure from the last state and needs
    passes.

    Attributes:
        friction_angle: φ [rad], in (0, π/2).

    Raises:
        InputError: an angle out of range.
    """

    friction_angle: float
    beside_law: bool = False
    lagged: bool = True

    def __post_init__(self) -> None:
        if not 0 < self.friction_angle < np.pi / 2:
            raise InputError(f"friction_angle: got {self.friction_angle}; expected between 0 and π/2 in radians")

    def during(self, undo: Tensor, state: Tensor, mu: Tensor, lam: Tensor, step: float) -> FlowStep:
        """The response during one step, see `FlowRule`; pressure from `state`."""
        sine, bulk = float(np.sin(self.friction_angle)), _bulk(mu, lam)
        slope = float(np.sqrt(2 / 3)) * 6 * sine / (3 - sine)
        pressure = (-bulk * torch.linalg.det(state @ undo).clamp_min(_TINY).log()).clamp_min(0.0)
        return LogarithmicStep(undo, mu, bulk, slope * pressure, 1.0, tension=False)


@dataclass(frozen=True)
class StandardLinearSolid:
    """A Maxwell element parallel to the body's elastic law: stiff at first, soft later; finite strain, deviatoric.

    At constant strain, the element's stress decays as exp(−t/τ), exactly so in the time steps. The law's E and ν are
    those of slow motion; in fast motion the shear modulus is (1 + modulus_ratio) μ.

    Attributes:
        modulus_ratio: shear modulus of the Maxwell element over the law's μ.
        relaxation_time: τ [s].

    Raises:
        InputError: a number out of range.
    """

    modulus_ratio: float
    relaxation_time: float
    beside_law: bool = True
    lagged: bool = False

    def __post_init__(self) -> None:
        for name in ("modulus_ratio", "relaxation_time"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"{name}: got {getattr(self, name)}; expected a finite number > 0")

    def during(self, undo: Tensor, state: Tensor, mu: Tensor, lam: Tensor, step: float) -> FlowStep:
        """The response during one step, see `FlowRule`."""
        left = float(np.exp(-step / self.relaxation_time))
        unlimited = torch.full_like(mu, torch.inf)
        return LogarithmicStep(undo, self.modulus_ratio * mu, torch.zeros_like(mu), unlimited, left, tension=True)
