"""Elastic laws with added terms: fibres (transverse anisotropy), stiffening with strain.

Each addition returns a `Law`, linear in μ as every law is, so that derivatives by E and ν remain valid.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.errors import InputError
from physconvex.materials.laws import Law, get_law


def combined(name: str, first: tuple[float, Law], second: tuple[float, Law], ground: Law | None = None) -> Law:
    """So much of one law and so much of another."""
    (a, one), (b, other) = first, second
    return Law(
        name,
        lambda f, mu, lam: a * one.energy(f, mu, lam) + b * other.energy(f, mu, lam),
        lambda f, mu, lam: a * one.stress(f, mu, lam) + b * other.stress(f, mu, lam),
        lambda f, mu, lam: a * one.hessian(f, mu, lam) + b * other.hessian(f, mu, lam),
        ground,
    )


def _added(law: Law, addition: Law) -> Law:
    """The sum of two laws."""
    return combined(f"{law.name}+{addition.name}", (1.0, law), (1.0, addition), law.ground or law)


def less_ground(law: Law, ground: Law) -> Law:
    """The term added to a law: the difference of the two."""
    return combined(f"{law.name}-{ground.name}", (1.0, law), (-1.0, ground))


def with_fibres(law: str | Law, direction: Sequence[float] | Float[np.ndarray, "*Q 3"], modulus_ratio: float) -> Law:
    """Transverse anisotropy: fibres along a rest direction a that resist stretch (and compression).

    Ψ_f = k/8 (I₄ − 1)², I₄ = |F a|², k = modulus_ratio × μ: the quadratic form of the standard reinforcing model
    (Qiu & Pence 1997). For small strains a bar along the fibres has the modulus E + k, one across them
    E / (1 − ν² k/(E + k)).

    Args:
        law: the elastic law of the ground.
        direction: a, any length; shape [3], or one per interior sample of a body, [Q, 3].
        modulus_ratio: k/μ ≥ 0.

    Raises:
        InputError: a zero direction or a negative ratio.
    """
    ground, array = get_law(law) if isinstance(law, str) else law, np.asarray(direction, dtype=np.float64)
    lengths = np.linalg.norm(array, axis=-1, keepdims=True)
    if array.shape[-1:] != (3,) or not (np.isfinite(array).all() and (lengths > 0).all()):
        raise InputError(f"direction: got shape {array.shape}; expected directions of shape [3] or [Q, 3], not zero")
    if not (np.isfinite(modulus_ratio) and modulus_ratio >= 0):
        raise InputError(f"modulus_ratio: got {modulus_ratio}; expected a finite number ≥ 0")
    fibre = torch.as_tensor(array / lengths)

    def stretched(f: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """a, F a, and I₄ − 1."""
        a = fibre.to(f).expand(*f.shape[:-2], 3)
        moved = (f @ a.unsqueeze(-1)).squeeze(-1)
        return a, moved, (moved * moved).sum(-1) - 1

    def energy(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
        return modulus_ratio * mu / 8 * stretched(f)[2] ** 2

    def stress(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:  # ∂I₄/∂F = 2 F a aᵀ
        a, moved, excess = stretched(f)
        return (modulus_ratio * mu / 2 * excess)[..., None, None] * moved.unsqueeze(-1) * a.unsqueeze(-2)

    def hessian(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
        a, moved, excess = stretched(f)
        flat = (moved.unsqueeze(-1) * a.unsqueeze(-2)).flatten(-2)
        along = a.unsqueeze(-1) * a.unsqueeze(-2)
        eye = torch.eye(3).to(f)
        geometric = torch.einsum("ik,...jl->...ijkl", eye, along).flatten(-2).flatten(-3, -2)
        material = flat.unsqueeze(-1) * flat.unsqueeze(-2)
        return (modulus_ratio * mu)[..., None, None] * (material + 0.5 * excess[..., None, None] * geometric)

    return _added(ground, Law("fibres", energy, stress, hessian))


def with_strain_stiffening(law: str | Law, rate: float) -> Law:
    """Stiffening in shear and stretch: Yeoh's second term on the isochoric strain, Ψ_s = rate μ/2 (Ī₁ − 3)².

    Ī₁ = J^(−2/3) tr FᵀF (Yeoh 1993, in the decoupled form). Ī₁ − 3 is of second order in the strain, so that E and ν of
    small strains stay; in simple shear γ the shear stress gains 2 rate μ γ³. Infinite at J ≤ 0.

    Args:
        law: the elastic law it is added to.
        rate: ≥ 0.

    Raises:
        InputError: a negative rate.
    """
    ground = get_law(law) if isinstance(law, str) else law
    if not (np.isfinite(rate) and rate >= 0):
        raise InputError(f"rate: got {rate}; expected a finite number ≥ 0")

    def invariant(f: Tensor) -> tuple[Tensor, Tensor]:
        """J^(−2/3) and Ī₁ − 3; infinite where J ≤ 0."""
        j = torch.linalg.det(f)
        shrink = torch.where(j > 0, j.clamp_min(torch.finfo(f.dtype).tiny) ** (-2 / 3), torch.inf)
        return shrink, shrink * (f * f).sum((-1, -2)) - 3

    def slope(f: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """J^(−2/3), Ī₁ − 3, G = F⁻ᵀ and ∂Ī₁/∂F = 2 J^(−2/3) F − 2/3 Ī₁ G."""
        shrink, excess = invariant(f)
        g = torch.linalg.inv(f).mT
        return shrink, excess, g, 2 * shrink[..., None, None] * f - (2 / 3 * (excess + 3))[..., None, None] * g

    def energy(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
        return rate * mu / 2 * invariant(f)[1] ** 2

    def stress(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
        _, excess, _, first = slope(f)
        return (rate * mu * excess)[..., None, None] * first

    def hessian(f: Tensor, mu: Tensor, lam: Tensor) -> Tensor:
        shrink, excess, g, first = slope(f)
        flat_f, flat_g, flat_first = f.flatten(-2), g.flatten(-2), first.flatten(-2)
        # ∂(J^(−2/3)) = −2/3 J^(−2/3) G, ∂G_ij/∂F_kl = −G_il G_kj
        second = -(4 / 3) * shrink[..., None, None] * flat_f.unsqueeze(-1) * flat_g.unsqueeze(-2)
        second = second - 2 / 3 * flat_g.unsqueeze(-1) * flat_first.unsqueeze(-2)
        mixed = torch.einsum("...il,...kj->...ijkl", g, g).flatten(-2).flatten(-3, -2)
        second = second + (2 / 3 * (excess + 3))[..., None, None] * mixed
        second = second + 2 * shrink[..., None, None] * torch.eye(9).to(f)
        outer = flat_first.unsqueeze(-1) * flat_first.unsqueeze(-2)
        return (rate * mu)[..., None, None] * (outer + excess[..., None, None] * second)

    return _added(ground, Law("stiffening", energy, stress, hessian))
