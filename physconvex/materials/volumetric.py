"""Elastic laws Ψ = μ/2 (I₁ − 3) + f(J), the neo-Hookean ones: f, and arithmetic in arrays of one component each.

`sources/shared/neo_hookean.h` and `volumetric.h` hold f for C++ and CUDA.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

Array = np.ndarray
NEARLY_FLAT = 1e-4  # |J| over |C|^(3/2) below which a division by J costs digits
VolumetricTerm = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor, Tensor]]
"""f, f' and f'' as functions of J, μ and λ."""


@dataclass(frozen=True)
class MaterialPoints:
    """Points at which a body's law is evaluated: Q points of each of E elements, or Q samples of a reduced body.

    Attributes:
        gradients: ∂N_a/∂X [1/m] of the shape functions, shape [E, Q, n, 3], of a reduced body [Q, 3, R].
        weights: volumes [m³], shape [E, Q] or [Q].
        mu, lam: Lamé constants [Pa], of the shape of the weights.
    """

    gradients: Array
    weights: Array
    mu: Array
    lam: Array


def _quadratic(j: Tensor, mu: Tensor, lam: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Smith, de Goes, Kim 2018 ("Stable Neo-Hookean Flesh Simulation"), eq. 13 without the log term.

    f = −μ (J − 1) + (λ + μ)/2 (J − 1)². With λ in place of λ + μ it would linearise to λ − μ.
    """
    d = j - 1
    slope = (lam + mu) * d - mu
    return 0.5 * d * (slope - mu), slope, lam + mu


def _logarithmic(j: Tensor, mu: Tensor, lam: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Bonet & Wood 2008, eq. 6.27: f = −μ ln J + λ/2 (ln J)², infinite at J ≤ 0."""
    proper = j > 0
    safe = torch.where(proper, j, 1.0)
    log = safe.log()
    value = torch.where(proper, (0.5 * lam * log - mu) * log, torch.inf)
    return value, (lam * log - mu) / safe, (lam + mu - lam * log) / safe**2


VOLUMETRIC_TERMS: dict[str, VolumetricTerm] = {"neo_hookean": _quadratic, "neo_hookean_log": _logarithmic}
KERNEL_LAWS = tuple(VOLUMETRIC_TERMS)  # by their number in the compiled arithmetic


def slopes_of_volume(term: VolumetricTerm, j: Array, mu: Array, lam: Array) -> tuple[Array, Array, Array]:
    """f, f' and f'' of arrays."""
    value, slope, curvature = term(torch.from_numpy(j), torch.from_numpy(mu), torch.from_numpy(lam))
    return value.numpy(), slope.numpy(), curvature.numpy()


def cofactor_and_determinant(f: Float[Array, "3 3 Q"]) -> tuple[Float[Array, "3 3 Q"], Float[Array, " Q"]]:
    """cof F = J F⁻ᵀ, also where J = 0, and J."""
    ring = np.empty((5, 5, f.shape[2]))  # F continued periodically: the cofactor is then three array operations
    ring[:3, :3], ring[3:, :3] = f, f[:2]
    ring[:, 3:] = ring[:, :2]
    cofactor = ring[1:4, 1:4] * ring[2:, 2:]
    cofactor -= ring[1:4, 2:] * ring[2:, 1:4]
    return cofactor, np.einsum("jq,jq->q", f[0], cofactor[0])


@np.errstate(over="ignore", invalid="ignore")  # a far too long trial step has no finite energy, and is rejected
def energy_and_stress(
    term: VolumetricTerm, f: Float[Array, "3 3 Q"], weights: Array, mu: Array, lam: Array
) -> tuple[float, Float[Array, "3 3 Q"]]:
    """Energy [J], and the stresses μ F + f' cof F times the weights; they overwrite F."""
    cofactor, j = cofactor_and_determinant(f)
    value, slope, _ = slopes_of_volume(term, j, mu, lam)
    weighted_mu = weights * mu
    square = np.einsum("ijq,ijq->q", f, f)
    energy = 0.5 * float(weighted_mu @ (square - 3)) + float(weights @ value)
    cofactor *= weights * slope
    f *= weighted_mu
    f += cofactor
    return energy, f


def nearly_flat(cofactor: Float[Array, "3 3 Q"], j: Float[Array, " Q"]) -> bool:
    """Whether a body is squeezed flat at some point, so that division by J loses digits."""
    return bool((j * j < NEARLY_FLAT**2 * np.einsum("ijq,ijq->q", cofactor, cofactor) ** 1.5).any())
