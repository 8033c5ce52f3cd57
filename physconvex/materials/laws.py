"""Elastic laws as triples energy / stress / hessian of the deformation gradient F, their constants, and viscosity.

Every law takes F [..., 3, 3] and the Lamé constants mu, lam [Pa] (broadcastable to [...]) and returns

- energy: energy density Ψ [J/m³], shape [...];
- stress: first Piola–Kirchhoff stress P = ∂Ψ/∂F [Pa], shape [..., 3, 3];
- hessian: ∂P/∂F [Pa], shape [..., 9, 9], F flattened row by row.

All of them linearise at F = I to linear elasticity with the same E and ν. If a law needs other constants for this (the
λ + μ form of Smith et al. 2018), a comment says so. Any device, any float dtype.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.errors import InputError
from physconvex.materials.volumetric import VOLUMETRIC_TERMS, VolumetricTerm

LawName = Literal["neo_hookean", "neo_hookean_log", "stvk", "corotated", "linear"]
_BOUNDS = {"youngs_modulus": (0.0, np.inf), "poisson_ratio": (-1.0, 0.5), "density": (0.0, np.inf)}
Triple = Callable[[Tensor, Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Law:
    """An elastic law: three functions of (F, mu, lam); see the module's docstring for shapes and units.

    `ground` is the original law, if terms are added to it. `volumetric` is f if the law is Ψ = μ/2 (I₁ − 3) + f(J), for
    which there is fast arithmetic, see `physconvex.materials.volumetric`.
    """

    name: str
    energy: Triple
    stress: Triple
    hessian: Triple
    ground: Law | None = None
    volumetric: VolumetricTerm | None = None


def lame_parameters(youngs_modulus: Tensor, poisson_ratio: Tensor) -> tuple[Tensor, Tensor]:
    """Lamé constants (mu, lam) [Pa] of linear elasticity from E [Pa] and ν [-]."""
    mu = youngs_modulus / (2 * (1 + poisson_ratio))
    lam = youngs_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    return mu, lam


def checked_constant(
    name: str, value: float | Float[np.ndarray, ...], shape: tuple[int, ...]
) -> Float[np.ndarray, ...]:
    """The values of E [Pa], ν [-] or ρ [kg/m³], of a shape.

    Raises:
        InputError: values of another shape or out of the range of the constant of that name.
    """
    array, (low, high) = np.asarray(value, dtype=np.float64), _BOUNDS[name]
    if array.shape not in ((), shape):
        raise InputError(f"{name}: got shape {array.shape}; expected a number or {list(shape)}")
    if not ((array > low) & (array < high)).all():
        raise InputError(f"{name}: got values in [{array.min()}, {array.max()}]; expected inside ({low}, {high})")
    return np.broadcast_to(array, shape).copy()


def get_law(name: str) -> Law:
    """The law of that name.

    Raises:
        InputError: no law has the name.
    """
    if name not in LAWS:
        raise InputError(f"law: got {name!r}; expected one of {', '.join(get_args(LawName))}")
    return LAWS[name]


def project_to_positive(hessian: Tensor) -> Tensor:
    """Nearest positive semi-definite matrices (negative eigenvalues set to zero), shape [..., n, n]."""
    values, vectors = torch.linalg.eigh(hessian)
    return (vectors * values.clamp_min(0).unsqueeze(-2)) @ vectors.mT


def _levi_civita() -> Tensor:
    eps = torch.zeros(3, 3, 3, dtype=torch.float64)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        eps[i, j, k], eps[i, k, j] = 1, -1
    return eps


# cof_ij = ½ ε_ikb ε_jld F_kl F_bd, hence ∂cof_ij/∂F_kl = ε_ikb ε_jld F_bd
_COFACTOR_DERIVATIVE = torch.einsum("ikb,jld->bdijkl", _levi_civita(), _levi_civita()).reshape(9, 81)
_EYE9 = torch.eye(9, dtype=torch.float64)
_EYE3 = torch.eye(3, dtype=torch.float64)


def _like(constant: Tensor, f: Tensor) -> Tensor:
    return constant.to(device=f.device, dtype=f.dtype)


def _cofactor(f: Tensor) -> Tensor:
    """cof F = J F⁻ᵀ, also where J = 0."""
    a, b, c = f.unbind(-2)
    return torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], dim=-2)


def _determinant(f: Tensor, cofactor: Tensor) -> Tensor:
    return (f[..., 0, :] * cofactor[..., 0, :]).sum(-1)


def _cofactor_hessian(f: Tensor) -> Tensor:
    return (f.reshape(*f.shape[:-2], 9) @ _like(_COFACTOR_DERIVATIVE, f)).reshape(*f.shape[:-2], 9, 9)


def _outer(a: Tensor) -> Tensor:
    """vec(a) vec(a)ᵀ, shape [..., 9, 9]."""
    flat = a.reshape(*a.shape[:-2], 9)
    return flat.unsqueeze(-1) * flat.unsqueeze(-2)


def _m(x: Tensor) -> Tensor:
    """A scalar field shaped to multiply matrices."""
    return x[..., None, None]


# --- Neo-Hookean: Ψ = μ/2 (I₁ − 3) + f(J), f of `physconvex.materials.volumetric`.


def _volumetric_energy(term: VolumetricTerm, f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    return mu / 2 * ((f * f).sum((-1, -2)) - 3) + term(_determinant(f, _cofactor(f)), mu, lam)[0]


def _volumetric_stress(term: VolumetricTerm, f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    cofactor = _cofactor(f)
    return _m(mu) * f + _m(term(_determinant(f, cofactor), mu, lam)[1]) * cofactor


def _volumetric_hessian(term: VolumetricTerm, f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    cofactor = _cofactor(f)
    _, slope, curvature = term(_determinant(f, cofactor), mu, lam)
    hessian = _m(slope) * _cofactor_hessian(f)
    hessian += _m(curvature) * _outer(cofactor)
    return hessian + _m(mu) * _like(_EYE9, f)


def _volumetric_law(name: str, term: VolumetricTerm) -> Law:
    return Law(
        name,
        partial(_volumetric_energy, term),
        partial(_volumetric_stress, term),
        partial(_volumetric_hessian, term),
        volumetric=term,
    )


# --- St Venant–Kirchhoff: Ψ = μ E:E + λ/2 (tr E)², E = ½ (FᵀF − I).


def _green_strain(f: Tensor) -> Tensor:
    return 0.5 * (f.mT @ f - _like(_EYE3, f))


def _trace(a: Tensor) -> Tensor:
    return a.diagonal(dim1=-2, dim2=-1).sum(-1)


def isotropic_stress(strain: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    """2 μ E + λ tr E, Hooke's law of a strain, or of a strain rate and viscosities."""
    return 2 * _m(mu) * strain + _m(lam * _trace(strain)) * _like(_EYE3, strain)


def _isotropic_energy(strain: Callable[[Tensor], Tensor], f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    found = strain(f)
    return mu * (found * found).sum((-1, -2)) + lam / 2 * _trace(found) ** 2


def _stvk_stress(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    return f @ isotropic_stress(_green_strain(f), mu, lam)


def strain_stiffness(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    """F-dependent stiffness of a quadratic energy in the Green strain, without the geometric term, [..., 9, 9].

    dP_ij = λ F_ij F_kl dF_kl + μ (F_il F_kj + (F Fᵀ)_ik δ_jl) dF_kl. Also the Kelvin–Voigt viscosity tensor.
    """
    shear = torch.einsum("...il,...kj->...ijkl", f, f)
    shear = shear + torch.einsum("...ik,jl->...ijkl", f @ f.mT, _like(_EYE3, f))
    return _m(mu) * shear.reshape(*f.shape[:-2], 9, 9) + _m(lam) * _outer(f)


def _stvk_hessian(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    geometric = torch.einsum("ik,...jl->...ijkl", _like(_EYE3, f), isotropic_stress(_green_strain(f), mu, lam))
    return geometric.reshape(*f.shape[:-2], 9, 9) + strain_stiffness(f, mu, lam)


# --- Fixed corotated (Stomakhin et al. 2012, eq. 5): Ψ = μ ‖F − R‖² + λ/2 (J − 1)².


def _signed_svd(f: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """F = U diag(s) Vᵀ with det U = det V = 1; the smallest singular value carries the sign."""
    u, s, vt = torch.linalg.svd(f)
    sign_u, sign_v = torch.linalg.det(u).sign(), torch.linalg.det(vt).sign()
    u = torch.cat([u[..., :2], u[..., 2:] * _m(sign_u)], dim=-1)
    vt = torch.cat([vt[..., :2, :], vt[..., 2:, :] * _m(sign_v)], dim=-2)
    s = torch.cat([s[..., :2], s[..., 2:] * (sign_u * sign_v).unsqueeze(-1)], dim=-1)
    return u, s, vt


def _corotated_energy(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    u, _, vt = _signed_svd(f)
    j = _determinant(f, _cofactor(f)) - 1
    return mu * ((f - u @ vt) ** 2).sum((-1, -2)) + lam / 2 * j * j


def _corotated_stress(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    u, _, vt = _signed_svd(f)
    cofactor = _cofactor(f)
    j = _determinant(f, cofactor) - 1
    return 2 * _m(mu) * (f - u @ vt) + _m(lam * j) * cofactor


def _corotated_hessian(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    u, s, vt = _signed_svd(f)
    cofactor = _cofactor(f)
    j = _determinant(f, cofactor) - 1
    # ∂R/∂F = Σ_{i<j} 2/(s_i + s_j) t tᵀ with the twists t = U (e_i e_jᵀ − e_j e_iᵀ)/√2 Vᵀ (Smith et al. 2019, §3)
    rotation = torch.zeros(*f.shape[:-2], 9, 9, dtype=f.dtype, device=f.device)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        twist = u[..., :, a, None] * vt[..., b, None, :] - u[..., :, b, None] * vt[..., a, None, :]
        gap = (s[..., a] + s[..., b]).clamp_min(1e-6)
        rotation = rotation + _m(1 / gap) * _outer(twist)
    hessian = 2 * _m(mu) * (_like(_EYE9, f) - rotation) + _m(lam) * _outer(cofactor)
    return hessian + _m(lam * j) * _cofactor_hessian(f)


# --- Linear elasticity: Ψ = μ ε:ε + λ/2 (tr ε)², ε = sym F − I. Not rotation invariant.


def _small_strain(f: Tensor) -> Tensor:
    return 0.5 * (f + f.mT) - _like(_EYE3, f)


def _linear_stress(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    return isotropic_stress(_small_strain(f), mu, lam)


def _linear_hessian(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    return strain_stiffness(_like(_EYE3, f).expand(f.shape), mu, lam)


# --- Kelvin–Voigt viscosity: rate potential μ_v Ė:Ė + λ_v/2 (tr Ė)², Ė = sym(F*ᵀ Ḟ), F* frozen for a time step.


def strain_rate(state: Tensor, rate: Tensor) -> Tensor:
    """Ė [1/s], shape [..., 3, 3], of F* and Ḟ [1/s]."""
    strain = state.mT @ rate
    return 0.5 * (strain + strain.mT)


def viscous_stress(state: Tensor, rate: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    """First Piola–Kirchhoff stress F* (2 μ_v Ė + λ_v tr Ė) [Pa].

    Args:
        state: F*, [..., 3, 3].
        rate: Ḟ [1/s], [..., 3, 3].
        mu, lam: viscosities μ_v, λ_v [Pa·s].
    """
    return state @ isotropic_stress(strain_rate(state, rate), mu, lam)


LAWS: dict[str, Law] = {
    law.name: law
    for law in (
        *(_volumetric_law(name, term) for name, term in VOLUMETRIC_TERMS.items()),
        Law("stvk", partial(_isotropic_energy, _green_strain), _stvk_stress, _stvk_hessian),
        Law("corotated", _corotated_energy, _corotated_stress, _corotated_hessian),
        Law("linear", partial(_isotropic_energy, _small_strain), _linear_stress, _linear_hessian),
    )
}
