"""Isotropic functions of the principal logarithmic strains ε_i = ln σ_i of a deformation gradient, σ its stretches.

With W(ε) given by its slopes ∂W/∂ε_i (the principal Kirchhoff stresses) and second derivatives, the derivatives by F
follow in the frame F = U diag(σ) Vᵀ (Smith et al. 2019, "Analytic Eigensystems for Isotropic Distortion Energies"):
P = U diag(W_i/σ_i) Vᵀ, and ∂P/∂F acts on the stretches by A_ij = W_ij/(σ_i σ_j) − δ_ij W_i/σ_i² and on each pair
i < j by (P_i + P_j)/(σ_i + σ_j) (rotation) and (P_i − P_j)/(σ_i − σ_j) (shear).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from physconvex.kernels import singular_values

__all__ = ["ALL_BUT_FLAT", "PrincipalFrame", "principal_hessian", "principal_stress", "pulled_back"]

_SMALLEST = 1e-30
_FLAT = 1e-2  # smallest stretch over the largest one
ALL_BUT_FLAT = 1e-12  # the same below which there is no third axis, of compiled arithmetic
_CLOSE = 1e-6  # relative distance of two stretches below which their difference quotient is a derivative


@dataclass(frozen=True)
class PrincipalFrame:
    """F = U diag(σ) Vᵀ.

    Attributes:
        u: [..., 3, 3].
        stretches: σ > 0, shape [..., 3].
        vt: Vᵀ, shape [..., 3, 3].
        proper: where det F > 0, shape [...]; a body turned inside out has no logarithmic strain.
    """

    u: Tensor
    stretches: Tensor
    vt: Tensor
    proper: Tensor

    @classmethod
    def of(cls, f: Tensor) -> PrincipalFrame:
        """The frame of deformation gradients of shape [..., 3, 3]."""
        u, s, vt = _singular_values(f)
        volume = (f[..., 0, :] * torch.linalg.cross(f[..., 1, :], f[..., 2, :])).sum(-1)
        return cls(u, s.clamp_min(_SMALLEST), vt, volume > 0)

    @property
    def strains(self) -> Tensor:
        """ln σ, shape [..., 3]."""
        return self.stretches.log()


def _singular_values(f: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """U, σ and Vᵀ: compiled; else by the eigenvectors of FᵀF, and by themselves where F is nearly flat.

    What the eigenvectors lose is the square of the ratio of two stretches, in units of rounding.
    """
    if (quick := singular_values(f, ALL_BUT_FLAT)) is not None:
        return quick
    square = f.mT @ f
    if bool(torch.isfinite(square).all()):
        values, vectors = torch.linalg.eigh(square)
        s, v = values.flip(-1).clamp_min(0.0).sqrt(), vectors.flip(-1)
        if bool((s[..., 2] > _FLAT * s[..., 0]).all()):
            return (f @ v) / s.unsqueeze(-2), s, v.mT
    u, s, vt = torch.linalg.svd(f)
    return u, s, vt


def principal_stress(frame: PrincipalFrame, slopes: Tensor) -> Tensor:
    """First Piola–Kirchhoff stress, shape [..., 3, 3], of slopes ∂W/∂ε, shape [..., 3]."""
    return (frame.u * (slopes / frame.stretches).unsqueeze(-2)) @ frame.vt


def principal_hessian(frame: PrincipalFrame, slopes: Tensor, curvature: Tensor) -> Tensor:
    """∂P/∂F, shape [..., 9, 9] with F flattened row by row, of ∂W/∂ε [..., 3] and ∂²W/∂ε² [..., 3, 3]."""
    s = frame.stretches
    p = slopes / s
    stretching = curvature / (s.unsqueeze(-1) * s.unsqueeze(-2)) - torch.diag_embed(slopes / s**2)
    axes = _mode(frame, (0, 1, 2), (0, 1, 2))  # u_i v_iᵀ, [..., 3, 9]
    hessian = axes.mT @ stretching @ axes
    for i, j in ((0, 1), (0, 2), (1, 2)):
        first, second = _mode(frame, (i, j), (j, i)).unbind(-2)
        turn, shear = first - second, first + second
        difference = s[..., i] - s[..., j]
        close = difference.abs() < _CLOSE * s[..., 0]
        limit = 0.5 * (stretching[..., i, i] + stretching[..., j, j]) - stretching[..., i, j]
        quotient = (p[..., i] - p[..., j]) / torch.where(close, torch.ones_like(difference), difference)
        shearing = torch.where(close, limit, quotient)
        turning = (p[..., i] + p[..., j]) / (s[..., i] + s[..., j])
        hessian = hessian + 0.5 * _weighted_outer(turning, turn) + 0.5 * _weighted_outer(shearing, shear)
    return hessian


def pulled_back(hessian: Tensor, undo: Tensor) -> Tensor:
    """∂P/∂F by F of a function of F F_f⁻¹, shape [..., 9, 9], from that by F F_f⁻¹ and from F_f⁻¹ [..., 3, 3]."""
    tensor = hessian.unflatten(-1, (3, 3)).unflatten(-3, (3, 3))
    return torch.einsum("...ja,...iakb,...lb->...ijkl", undo, tensor, undo).flatten(-2).flatten(-3, -2)


def _mode(frame: PrincipalFrame, rows: tuple[int, ...], columns: tuple[int, ...]) -> Tensor:
    """u_a v_bᵀ for the pairs (a, b), flattened, shape [..., n, 9]."""
    u, v = frame.u[..., list(rows)].mT, frame.vt[..., list(columns), :]
    return (u.unsqueeze(-1) * v.unsqueeze(-2)).flatten(-2)


def _weighted_outer(weight: Tensor, mode: Tensor) -> Tensor:
    return weight[..., None, None] * mode.unsqueeze(-1) * mode.unsqueeze(-2)
