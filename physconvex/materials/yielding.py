"""Perfect plasticity of a neo-Hookean body: its own elastic law below the yield stress.

F = F_e F_f as in `inelastic`. With a law Ψ = μ/2 (I₁ − 3) + f(J) of F_e, the deviatoric Kirchhoff stress is
dev(μ b_e), b_e = F_e F_eᵀ. With ε the logarithmic principal strains of the trial F_e = F F_f⁻¹, a step minimises

    Ψ_step(ε) = min over Δ, Σ Δ_i = 0, of  Ψ(ε − Δ) + k |Δ|,                k the limit of |dev τ|,

the incremental potential of von Mises' flow (Ortiz & Stainier 1999). The flow Δ has the direction of the stress at the
end of the step, which then lies on the yield surface. Its slopes are the stresses at x = ε − Δ; f(J) has no effect.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from physconvex.errors import ConvergenceError
from physconvex.materials.laws import Law
from physconvex.materials.principal_strains import PrincipalFrame, principal_hessian, principal_stress, pulled_back

_ITERATIONS, _CLOSE, _STRIDE = 60, 1e-13, 0.5  # Newton's: at most, residual of strains, longest step of a strain


@dataclass(frozen=True)
class _Yielding:
    """The flowing points.

    Attributes:
        proper: where det F > 0, of all points.
        where: their indices among all points.
        frame: of their trial F_e.
        strains: ε, shape [N, 3].
        kept: x, shape [N, 3].
        mu, limit: μ and k of them [Pa], shape [N].
    """

    proper: Tensor
    where: tuple[Tensor, ...]
    frame: PrincipalFrame
    strains: Tensor
    kept: Tensor
    mu: Tensor
    limit: Tensor

    @property
    def flow(self) -> Tensor:
        """Δ, shape [N, 3]."""
        return self.strains - self.kept


@dataclass(frozen=True)
class YieldStep:
    """Response during one time step, see `physconvex.materials.inelastic.FlowStep`.

    Attributes:
        undo: F_f⁻¹ at the start of the step, shape [..., 3, 3].
        mu, lam: Lamé constants [Pa], shape [...].
        limit: k [Pa], shape [...].
        law: the elastic law, one with a `volumetric` part.
    """

    undo: Tensor
    mu: Tensor
    lam: Tensor
    limit: Tensor
    law: Law
    _last: list[tuple[Tensor, _Yielding]] = field(default_factory=list, init=False, repr=False, compare=False)

    def energy(self, f: Tensor) -> Tensor:
        """Ψ_step [J/m³]; infinite where det F ≤ 0."""
        found = self._yielding(f)
        energy = torch.where(found.proper, self.law.energy(f @ self.undo, self.mu, self.lam), torch.inf)
        lost = 0.5 * found.mu * _difference_of_squares(found).sum(-1)
        energy[found.where] += lost + found.limit * torch.linalg.vector_norm(found.flow, dim=-1)
        return energy

    def stress(self, f: Tensor) -> Tensor:
        """First Piola–Kirchhoff stress ∂Ψ_step/∂F [Pa]."""
        found = self._yielding(f)
        stress = self.law.stress(f @ self.undo, self.mu, self.lam)
        stress[found.where] += principal_stress(found.frame, found.mu.unsqueeze(-1) * _difference_of_squares(found))
        return stress @ self.undo.mT

    def hessian(self, f: Tensor) -> Tensor:
        """∂P/∂F [Pa], shape [..., 9, 9], F flattened row by row."""
        found = self._yielding(f)
        hessian = self.law.hessian(f @ self.undo, self.mu, self.lam)
        mu = found.mu.unsqueeze(-1)
        curvature = _stiffness(mu, found.kept) @ _moved(found) - _stiffness(mu, found.strains)
        slopes = mu * _difference_of_squares(found)
        hessian[found.where] += principal_hessian(found.frame, slopes, curvature)
        return pulled_back(hessian, self.undo)

    def flowed(self, f: Tensor) -> Tensor:
        """F_f⁻¹ at the end of the step."""
        found = self._yielding(f)
        undo, vt = self.undo.clone(), found.frame.vt
        undo[found.where] = undo[found.where] @ (vt.mT * (-found.flow).exp().unsqueeze(-2)) @ vt
        return undo

    def _yielding(self, f: Tensor) -> _Yielding:
        """Kept, since energy and stress are requested at the same F."""
        if self._last and self._last[0][0] is f:
            return self._last[0][1]
        elastic = f @ self.undo
        square = elastic @ elastic.mT
        mean = square.diagonal(dim1=-2, dim2=-1).mean(-1)
        size = torch.linalg.matrix_norm(square - mean[..., None, None] * torch.eye(3).to(f))
        proper = torch.linalg.det(elastic) > 0
        where = torch.nonzero((self.mu * size > self.limit) & proper, as_tuple=True)
        frame, mu, limit = PrincipalFrame.of(elastic[where]), self.mu[where], self.limit[where]
        strains = frame.strains
        found = _Yielding(proper, where, frame, strains, _returned(strains, limit / mu), mu, limit)
        self._last[:] = [(f, found)]
        return found


def _difference_of_squares(found: _Yielding) -> Tensor:
    """Squares of the elastic stretches minus those of the trial, shape [N, 3]."""
    return (2 * found.kept).exp() - (2 * found.strains).exp()


def _deviator(values: Tensor) -> Tensor:
    return values - values.mean(-1, keepdim=True)


def _stiffness(mu: Tensor, strains: Tensor) -> Tensor:
    """Derivatives of μ exp(2 x) by x, shape [N, 3, 3]."""
    return torch.diag_embed(2 * mu * (2 * strains).exp())


def _system(kept: Tensor, amount: Tensor, ratio: Tensor) -> tuple[Tensor, Tensor]:
    """Direction of the stress over k, shape [N, 3], and the derivatives of the conditions of `_returned`, [N, 4, 4]."""
    squares = (2 * kept).exp()
    along = _deviator(squares) / ratio.unsqueeze(-1)
    slope = 2 * torch.diag_embed(squares) / ratio[..., None, None]
    slope = slope - slope.mean(-2, keepdim=True)  # of `along` by x
    matrix = along.new_zeros(*amount.shape, 4, 4)
    matrix[..., :3, :3] = torch.eye(3).to(kept) + amount[..., None, None] * slope
    matrix[..., :3, 3] = along
    matrix[..., 3, :3] = (along.unsqueeze(-2) @ slope).squeeze(-2)
    return along, matrix


def _returned(strains: Tensor, ratio: Tensor) -> Tensor:
    """x with x + γ n = ε and |n| = 1, where n = dev exp(2 x) μ/k, by Newton's method.

    Args:
        strains: ε, beyond the yield surface, shape [N, 3].
        ratio: k/μ, shape [N].

    Raises:
        ConvergenceError: no solution found.
    """
    mean, apart = strains.mean(-1, keepdim=True), _deviator(strains)
    slope = 2 * (2 * mean).exp() / ratio.unsqueeze(-1)  # of the stress over k by a small deviator of x
    size = torch.linalg.vector_norm(apart, dim=-1, keepdim=True)
    kept = mean + apart / (slope * size).clamp_min(1.0)
    amount = torch.linalg.vector_norm(strains - kept, dim=-1)
    close = _CLOSE * (1 + slope)
    for _ in range(_ITERATIONS):
        along, matrix = _system(kept, amount, ratio)
        missed = kept + amount.unsqueeze(-1) * along - strains
        beyond = 0.5 * ((along**2).sum(-1, keepdim=True) - 1)
        left = torch.cat([missed, beyond], dim=-1)
        if bool((left.abs() < close).all()):
            return kept
        step = torch.linalg.solve(matrix, -left.unsqueeze(-1)).squeeze(-1)
        longest = step[..., :3].abs().amax(-1, keepdim=True)
        step = step * (_STRIDE / longest.clamp_min(_STRIDE))
        kept, amount = kept + step[..., :3], (amount + step[..., 3]).clamp_min(0.0)
    raise ConvergenceError(f"plasticity: no stress on the yield surface was found in {_ITERATIONS} steps")


def _moved(found: _Yielding) -> Tensor:
    """Derivatives of x by ε, shape [N, 3, 3]."""
    amount = torch.linalg.vector_norm(found.flow, dim=-1)
    _, matrix = _system(found.kept, amount, found.limit / found.mu)
    right = torch.eye(4, 3).to(found.kept).expand(len(amount), 4, 3)
    return torch.linalg.solve(matrix, right)[..., :3, :]
