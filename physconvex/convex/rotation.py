"""Colours that turn with the body: rotation of spherical harmonics, rotations of deformation gradients."""

from __future__ import annotations

from functools import cache
from math import pi, sqrt

import torch
from jaxtyping import Float
from torch import Tensor

from physconvex.convex.spherical_harmonics import degree_of, harmonic_basis

__all__ = ["polar_rotation", "rotate_harmonics"]

DIRECTIONS = 49  # of the rule below, three times as many as there are harmonics


def polar_rotation(gradients: Float[Tensor, "N 3 3"]) -> Float[Tensor, "N 3 3"]:
    """The rotations R of F = R U (polar decomposition), by F = V Σ Wᵀ, R = V diag(1, 1, det V det W) Wᵀ.

    The nearest rotation also where F turns the body inside out.
    """
    left, _, right = torch.linalg.svd(gradients)
    sign = torch.det(left @ right).sign()
    flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], dim=-1)
    return (left * flip[:, None]) @ right


def rotate_harmonics(harmonics: Float[Tensor, "N S 3"], rotations: Float[Tensor, "N 3 3"]) -> Float[Tensor, "N S 3"]:
    """Coefficients of the rotated functions: what was seen along d is seen along R d.

    Harmonics of one degree span a space that rotations leave alone, so Y_l(Rᵀ d) = M_lᵀ Y_l(d) with an orthogonal
    matrix M_l for all d. M_l is read off by least squares from fixed directions, which is exact up to rounding; the new
    coefficients are M_l c_l. Differentiable by both.
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
    """Directions on a Fibonacci spiral and, row by row, what reads a coefficient off the values there."""
    index = torch.arange(DIRECTIONS, dtype=torch.float64) + 0.5
    z, angle = 1 - 2 * index / DIRECTIONS, pi * (1 + sqrt(5)) * index
    radius = (1 - z.square()).sqrt()
    directions = torch.stack([radius * angle.cos(), radius * angle.sin(), z], dim=-1)
    basis = harmonic_basis(directions, degree)
    rows = [
        torch.linalg.pinv(basis[:, level**2 : (level + 1) ** 2]) for level in range(degree + 1)
    ]  # each degree alone, since rotations do not mix them
    return directions, torch.cat(rows)
