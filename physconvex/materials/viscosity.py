"""Kelvin–Voigt viscosity: rate potential μ_v Ė:Ė + λ_v/2 (tr Ė)², Ė = sym(F*ᵀ Ḟ), F* frozen for a time step."""

from __future__ import annotations

import torch
from torch import Tensor


def strain_rate(state: Tensor, rate: Tensor) -> Tensor:
    """Ė [1/s], shape [..., 3, 3], of F* and Ḟ [1/s]."""
    strain = state.mT @ rate
    return 0.5 * (strain + strain.mT)


def inner_viscous_stress(strain: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    """2 μ_v Ė + λ_v tr Ė [Pa], the stress without the F* in front, of Ė and viscosities [Pa·s]."""
    trace = strain.diagonal(dim1=-2, dim2=-1).sum(-1)
    return 2 * mu[..., None, None] * strain + (lam * trace)[..., None, None] * torch.eye(3).to(strain)


def viscous_stress(state: Tensor, rate: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
    """First Piola–Kirchhoff stress F* (2 μ_v Ė + λ_v tr Ė) [Pa].

    Args:
        state: F*, [..., 3, 3].
        rate: Ḟ [1/s], [..., 3, 3].
        mu, lam: viscosities μ_v, λ_v [Pa·s].
    """
    return state @ inner_viscous_stress(strain_rate(state, rate), mu, lam)
