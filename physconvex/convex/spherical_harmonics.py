"""Colour that depends on the direction of view, as a sum of real spherical harmonics."""

from __future__ import annotations

from functools import cache
from math import factorial, isqrt, pi, prod, sqrt

import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.errors import InputError

GREATEST_DEGREE = 3
MIDDLE = 0.5  # colour where all coefficients are zero
DIRECTIONS = 49  # at which rotated functions are evaluated, three times as many as there are harmonics


def degree_of(count: int) -> int:
    """Degree of a series of (degree + 1)² coefficients.

    Raises:
        InputError: no such degree, or one above `GREATEST_DEGREE`.

    >>> degree_of(16)
    3
    """
    degree = isqrt(count) - 1
    if (degree + 1) ** 2 != count or not 0 <= degree <= GREATEST_DEGREE:
        raise InputError(f"harmonics: got {count} coefficients; expected 1, 4, 9 or 16 (degree 0 to {GREATEST_DEGREE})")
    return degree


def harmonic_basis(directions: Float[Tensor, "... 3"], degree: int) -> Float[Tensor, "... S"]:
    """Real orthonormal spherical harmonics Y_lm of unit directions, at index l² + l + m.

    Y_lm = N_lm Π_lm(z) Re (x + iy)^m for m ≥ 0, and the imaginary part of (x + iy)^|m| for m < 0, where
    Π_lm(z) = P_lm(z) / (1 − z²)^(m/2) without the Condon–Shortley sign, N_lm² = (2l + 1)/(4π) (l − m)!/(l + m)!, and
    twice that for m ≠ 0 (Abramowitz & Stegun 8.6.6 and 8.5.3 for the Legendre functions).
    """
    x, y, z = directions.unbind(-1)
    columns: list[Tensor] = [z] * (degree + 1) ** 2
    real, imaginary = torch.ones_like(z), torch.zeros_like(z)
    for order in range(degree + 1):
        before, legendre = torch.zeros_like(z), torch.ones_like(z) * prod(range(1, 2 * order, 2))
        for level in range(order, degree + 1):
            norm = sqrt((2 * level + 1) / (4 * pi) * factorial(level - order) / factorial(level + order))
            norm *= sqrt(2) if order else 1
            columns[level * (level + 1) + order] = norm * legendre * real
            if order:
                columns[level * (level + 1) - order] = norm * legendre * imaginary
            # (l − m + 1) P_(l+1)m = (2l + 1) z P_lm − (l + m) P_(l−1)m
            after = ((2 * level + 1) * z * legendre - (level + order) * before) / (level - order + 1)
            before, legendre = legendre, after
        real, imaginary = real * x - imaginary * y, real * y + imaginary * x
    return torch.stack(columns, dim=-1)


def view_colours(harmonics: Float[Tensor, "N S 3"], directions: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Colours along unit directions (camera to object, world frame): max(0, 1/2 + Σ c_lm Y_lm)."""
    basis = harmonic_basis(directions, degree_of(harmonics.shape[1]))
    return (MIDDLE + (basis[..., None] * harmonics).sum(dim=-2)).clamp(min=0.0)


def coefficients_of_colour(colour: Float[Tensor, "N 3"], degree: int = GREATEST_DEGREE) -> Float[Tensor, "N S 3"]:
    """Coefficients of colours [N, 3] that are the same from everywhere."""
    coefficients = colour.new_zeros((len(colour), (degree + 1) ** 2, 3))
    coefficients[:, 0] = (colour - MIDDLE) * sqrt(4 * pi)
    return coefficients


def rotate_harmonics(harmonics: Float[Tensor, "N S 3"], rotations: Float[Tensor, "N 3 3"]) -> Float[Tensor, "N S 3"]:
    """Coefficients of the rotated functions: the colour along d becomes the colour along R d.

    Rotations map the harmonics of one degree to each other, so Y_l(Rᵀ d) = M_lᵀ Y_l(d) with an orthogonal matrix M_l
    for all d. M_l follows by least squares from fixed directions, which is exact up to rounding. The new coefficients
    are M_l c_l. Differentiable by both.
    """
    degree = degree_of(harmonics.shape[1])
    directions, inverse = _rule(degree)
    directions, inverse = directions.to(harmonics), inverse.to(harmonics)
    turned = torch.einsum("qj,nji->nqi", directions, rotations)  # Rᵀ d
    values = harmonic_basis(turned, degree)
    parts = [harmonics[:, :1]]
    for level in range(1, degree + 1):
        block = slice(level**2, (level + 1) ** 2)
        matrix = inverse[block] @ values[..., block]  # column a: coefficients of Y_a(Rᵀ ·)
        parts.append(matrix @ harmonics[:, block])
    return torch.cat(parts, dim=1)


@cache
def _rule(degree: int) -> tuple[Tensor, Tensor]:
    """Directions on a Fibonacci spiral and, row by row, the linear map from values there to a coefficient."""
    index = torch.arange(DIRECTIONS, dtype=torch.float64) + 0.5
    z, angle = 1 - 2 * index / DIRECTIONS, pi * (1 + sqrt(5)) * index
    radius = (1 - z.square()).sqrt()
    directions = torch.stack([radius * angle.cos(), radius * angle.sin(), z], dim=-1)
    basis = harmonic_basis(directions, degree)
    # each degree alone, since rotations do not mix them
    rows = [torch.linalg.pinv(basis[:, level**2 : (level + 1) ** 2]) for level in range(degree + 1)]
    return directions, torch.cat(rows)
