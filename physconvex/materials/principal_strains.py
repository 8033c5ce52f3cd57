"""Isotropic functions of the principal logarithmic strains ε_i = ln σ_i of a deformation gradient, σ its stretches.

With W(ε) given by its slopes ∂W/∂ε_i (the principal Kirchhoff stresses) and second derivatives, the derivatives by F
follow in the frame F = U diag(σ) Vᵀ (Smith et al. 2019, "Analytic Eigensystems for Isotropic Distortion Energies"):
P = U diag(W_i/σ_i) Vᵀ, and ∂P/∂F acts on the stretches by A_ij = W_ij/(σ_i σ_j) − δ_ij W_i/σ_i² and on each pair
i < j by (P_i + P_j)/(σ_i + σ_j) (rotation) and (P_i − P_j)/(σ_i − σ_j) (shear).
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import torch
from torch import Tensor

from physconvex.kernels import POINTER, SOURCES, Kernel

_SMALLEST = 1e-30
_FLAT = 1e-2  # smallest stretch over the largest one
_ALL_BUT_FLAT = 1e-12  # the same below which there is no third axis, of compiled arithmetic
_CLOSE = 1e-6  # relative distance of two stretches below which their difference quotient is a derivative
_NUMBER, _INTEGER = ctypes.c_double, ctypes.c_int32
STRAIN_KERNEL = Kernel(
    SOURCES / "principal_strains",
    {
        "pc_singular_values": (_INTEGER, [ctypes.c_int64, POINTER, _NUMBER, *[POINTER] * 3]),
        "pc_flow_response": (_INTEGER, [ctypes.c_int64, *[POINTER] * 5, _NUMBER, _INTEGER, _NUMBER, *[POINTER] * 2]),
    },
)


@dataclass(frozen=True)
class PrincipalFrame:
    """F = U diag(σ) Vᵀ.

    Attributes:
        u: [..., 3, 3].
        stretches: σ > 0, shape [..., 3].
        vt: Vᵀ, shape [..., 3, 3].
        proper: where det F > 0, shape [...]; an inverted body has no logarithmic strain.
    """

    u: Tensor
    stretches: Tensor
    vt: Tensor
    proper: Tensor

    @classmethod
    def of(cls, f: Tensor) -> PrincipalFrame:
        """The frame of deformation gradients of shape [..., 3, 3]."""
        u, s, vt = _axes(f)
        volume = (f[..., 0, :] * torch.linalg.cross(f[..., 1, :], f[..., 2, :])).sum(-1)
        return cls(u, s.clamp_min(_SMALLEST), vt, volume > 0)

    @property
    def strains(self) -> Tensor:
        """ln σ, shape [..., 3]."""
        return self.stretches.log()


def _axes(f: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """U, σ and Vᵀ: compiled; else by the eigenvectors of FᵀF, or by the SVD if F is nearly flat.

    The error of the eigenvectors is the squared ratio of two stretches, in units of rounding.
    """
    if (quick := singular_values(f)) is not None:
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


def singular_values(f: Tensor) -> tuple[Tensor, Tensor, Tensor] | None:
    """U [..., 3, 3], σ [..., 3] from the largest on and Vᵀ [..., 3, 3] of matrices [..., 3, 3], compiled.

    None if they are not float64 on the CPU, one is not finite or flat, or nothing can be compiled.
    """
    if not _compilable(f):
        return None
    f = f.contiguous()
    u, s, vt = torch.empty_like(f), f.new_empty(f.shape[:-1]), torch.empty_like(f)
    given, *made = (array.data_ptr() for array in (f, u, s, vt))
    sound = STRAIN_KERNEL.library.pc_singular_values(s.numel() // 3, given, _ALL_BUT_FLAT, *made)
    return (u, s, vt) if sound else None


def flow_response(
    f: Tensor, undo: Tensor, mu: Tensor, bulk: Tensor, limit: Tensor, *, left: float, tension: bool
) -> tuple[Tensor, Tensor] | None:
    """Energy density [...], first Piola–Kirchhoff stress [..., 3, 3] at F of a `LogarithmicStep`, compiled.

    None as for `singular_values`, of F F_f⁻¹, or if the shapes differ.
    """
    if f.shape != undo.shape or mu.shape != f.shape[:-2] or not all(map(_compilable, (f, undo, mu, bulk, limit))):
        return None
    given = [array.contiguous() for array in (f, undo, mu, bulk, limit)]
    energy, stress = f.new_empty(mu.shape), f.new_empty(f.shape)
    *taken, density, pull = (array.data_ptr() for array in (*given, energy, stress))
    library = STRAIN_KERNEL.library
    sound = library.pc_flow_response(mu.numel(), *taken, left, int(tension), _ALL_BUT_FLAT, density, pull)
    return (energy, stress) if sound else None


def _compilable(f: Tensor) -> bool:
    return f.dtype == torch.float64 and f.device.type == "cpu" and not f.requires_grad and STRAIN_KERNEL.available
