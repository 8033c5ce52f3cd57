"""The Hessian of the neo-Hookean laws for many candidates at once: the arithmetic of `volumetric.py` in torch."""

from __future__ import annotations

import torch
from torch import Tensor

from physconvex.materials import Law

__all__ = ["volumetric_blocks", "volumetric_energy_and_gradient"]

_NEARLY_FLAT = 1e-4  # |J| over |C|^(3/2) below which the division by J costs digits


def _parts(law: Law, j: Tensor, mu: Tensor, lam: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """f, f', f'' of Ψ = μ/2 (I₁ − 3) + f(J); f is infinite where it has no value."""
    if law.name == "neo_hookean":
        slope = (lam + mu) * (j - 1) - mu
        return 0.5 * (j - 1) * (slope - mu), slope, (lam + mu).expand_as(j)
    log = torch.where(j > 0, j, 1.0).log()
    energy = torch.where(j > 0, (0.5 * lam * log - mu) * log, torch.inf)
    return energy, (lam * log - mu) / j, (lam + mu - lam * log) / j.square()


def volumetric_energy_and_gradient(
    law: Law, y: Tensor, mu: Tensor, lam: Tensor, weights: Tensor, by_function: Tensor
) -> tuple[Tensor, Tensor]:
    """Elastic energies [J], shape [b], and their derivatives by the coordinates [N], shape [b, R, 3].

    Args:
        law: one that `physconvex.volumetric_laws.is_volumetric` knows.
        y: coordinates [m], [b, R, 3].
        mu, lam: Lamé constants [Pa], [b, 1].
        weights: volumes [m³], [Q].
        by_function: ∂N/∂X_j [1/m], [R, (j, Q)].
    """
    f = (y.mT @ by_function).reshape(len(y), 3, 3, len(weights))
    after, before = f.roll(-1, 1), f.roll(-2, 1)  # rows i + 1 and i + 2: each cofactor is then two products
    cofactor = after.roll(-1, 2) * before.roll(-2, 2)
    cofactor -= after.roll(-2, 2) * before.roll(-1, 2)
    value, slope, _ = _parts(law, (f[:, 0] * cofactor[:, 0]).sum(1), mu, lam)
    energy = 0.5 * mu[:, 0] * ((f.square().sum((1, 2)) - 3) @ weights)
    stress = f * (mu * weights)[:, None, None] + cofactor * (weights * slope)[:, None, None]
    return energy + value @ weights, (stress.reshape(len(y), 3, -1) @ by_function.mT).mT


def volumetric_blocks(
    law: Law, f: Tensor, mu: Tensor, lam: Tensor, weights: Tensor, gradients: Tensor
) -> Tensor | None:
    """Second derivative of ∫ f(J) dV [N/m], components first, [b, 3, R, 3, R]; None where a sample is nearly flat.

    The term ∫ μ/2 |F|² dV, which is constant, is left out.

    Args:
        law: one that `physconvex.volumetric_laws.is_volumetric` knows.
        f: deformation gradients, [b, Q, 3, 3].
        mu, lam: Lamé constants [Pa], [b, 1].
        weights: volumes [m³], [Q].
        gradients: ∂N/∂X_j [1/m], [Q, 3, R].
    """
    rows = f.unbind(-2)
    pairs = ((rows[1], rows[2]), (rows[2], rows[0]), (rows[0], rows[1]))
    cofactor = torch.stack([torch.linalg.cross(a, b) for a, b in pairs], -2)
    j = (rows[0] * cofactor[..., 0, :]).sum(-1)
    if (j.square() < _NEARLY_FLAT**2 * cofactor.square().sum((-1, -2)) ** 1.5).any():
        return None
    _, slope, curvature = _parts(law, j, mu, lam)
    count, size = gradients.shape[0], gradients.shape[2]
    u = cofactor @ gradients  # [b, Q, i, R]
    flat = u.reshape(len(f), count, 3 * size)
    out = (flat.mT @ (flat * (weights * curvature).unsqueeze(-1))).reshape(len(f), 3, size, 3, size)
    turned = u * (weights * slope / j)[..., None, None]
    for i, k in ((0, 1), (0, 2), (1, 2)):
        part = u[:, :, i].mT @ turned[:, :, k]
        skew = part - part.mT
        out[:, i, :, k] += skew
        out[:, k, :, i] -= skew
    return out
