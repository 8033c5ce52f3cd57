"""Elastic laws Ψ = μ/2 (I₁ − 3) + f(J), the neo-Hookean ones, for arithmetic in arrays of one component each."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from physconvex.materials.laws import LAWS, Law

__all__ = [
    "KERNEL_LAWS",
    "NEARLY_FLAT",
    "VolumetricTerm",
    "cofactor_and_determinant",
    "energy_and_stress",
    "is_volumetric",
    "nearly_flat",
    "volumetric_term",
]

Array = np.ndarray
KERNEL_LAWS = ("neo_hookean", "neo_hookean_log")  # by their number there
NEARLY_FLAT = 1e-4  # |J| over |C|^(3/2) below which a division by J costs digits
VolumetricTerm = Callable[[Array, Array, Array], tuple[Array, Array, Array]]


def _quadratic(j: Array, mu: Array, lam: Array) -> tuple[Array, Array, Array]:
    """f, f', f'' of `neo_hookean`."""
    d = j - 1
    slope = (lam + mu) * d - mu
    return 0.5 * d * (slope - mu), slope, lam + mu


def _logarithmic(j: Array, mu: Array, lam: Array) -> tuple[Array, Array, Array]:
    """f, f', f'' of `neo_hookean_log`; f is infinite at J ≤ 0."""
    proper = j > 0
    safe = np.where(proper, j, 1.0)
    log = np.log(safe)
    energy = np.where(proper, (0.5 * lam * log - mu) * log, np.inf)
    return energy, (lam * log - mu) / safe, (lam + mu - lam * log) / safe**2


_TERMS: dict[str, VolumetricTerm] = {"neo_hookean": _quadratic, "neo_hookean_log": _logarithmic}


def is_volumetric(law: Law) -> bool:
    """Whether the law is one of those that this module knows."""
    return law.name in _TERMS and LAWS[law.name] is law


def volumetric_term(law: Law) -> VolumetricTerm:
    """f, f' and f'' as functions of J, μ and λ; of a law that `is_volumetric`."""
    return _TERMS[law.name]


def cofactor_and_determinant(f: Float[Array, "3 3 Q"]) -> tuple[Float[Array, "3 3 Q"], Float[Array, " Q"]]:
    """cof F = J F⁻ᵀ, also where J = 0, and J."""
    ring = np.empty((5, 5, f.shape[2]))  # F continued periodically: the cofactor is then three array operations
    ring[:3, :3], ring[3:, :3] = f, f[:2]
    ring[:, 3:] = ring[:, :2]
    cofactor = ring[1:4, 1:4] * ring[2:, 2:]
    cofactor -= ring[1:4, 2:] * ring[2:, 1:4]
    return cofactor, np.einsum("jq,jq->q", f[0], cofactor[0])


@np.errstate(over="ignore", invalid="ignore")  # a trial step far too long has no finite energy, and is refused
def energy_and_stress(
    term: VolumetricTerm, f: Float[Array, "3 3 Q"], weights: Array, mu: Array, lam: Array, *, with_energy: bool = True
) -> tuple[float, Float[Array, "3 3 Q"]]:
    """Energy [J] (NaN without), and the stresses μ F + f' cof F times the weights; they take F's place."""
    cofactor, j = cofactor_and_determinant(f)
    value, slope, _ = term(j, mu, lam)
    weighted_mu = weights * mu
    energy = float("nan")
    if with_energy:
        square = np.einsum("ijq,ijq->q", f, f)
        energy = 0.5 * float(weighted_mu @ (square - 3)) + float(weights @ value)
    cofactor *= weights * slope
    f *= weighted_mu
    f += cofactor
    return energy, f


def nearly_flat(cofactor: Float[Array, "3 3 Q"], j: Float[Array, " Q"]) -> bool:
    """Whether a body is squeezed flat at some point, so that what is divided by J loses its digits."""
    return bool((j * j < NEARLY_FLAT**2 * np.einsum("ijq,ijq->q", cofactor, cofactor) ** 1.5).any())
