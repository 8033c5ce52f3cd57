"""Random convex fields."""

from __future__ import annotations

import torch
from torch import Tensor

from physconvex.convex import ConvexField


def random_field(
    count: int = 3,
    *,
    points: int = 6,
    degree: int = 3,
    seed: int = 0,
    size: float = 0.2,
    spread: float = 0.3,
    edge: float = 60.0,
    dtype: torch.dtype = torch.float64,
) -> ConvexField:
    """Convexes of about `size` [m] scattered over about `spread` [m], with α about `edge` [1/m]."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=generator, dtype=torch.float64)

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(count, generator=generator, dtype=torch.float64)

    return ConvexField(
        spread * normal(count, 1, 3) + size * normal(count, points, 3),
        edge * uniform(0.5, 2.0),
        uniform(0.5, 2.0),
        uniform(0.3, 0.95),
        0.3 * normal(count, (degree + 1) ** 2, 3),
    ).to(dtype)


def cube(half: float = 0.5) -> ConvexField:
    """One cube about the origin with edges of twice `half` [m]."""
    corners = torch.tensor([[x, y, z] for x in (-half, half) for y in (-half, half) for z in (-half, half)])
    one = torch.ones(1, dtype=torch.float64)
    return ConvexField(corners.double()[None], 40 * one, one, 0.9 * one, torch.zeros(1, 1, 3, dtype=torch.float64))
