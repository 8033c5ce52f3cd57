"""Coefficients of Runge–Kutta–Chebyshev steps of second order, for stiffness along the negative real axis."""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float64

_DAMPING = 2 / 13


def reach(stages: int) -> float:
    """Extent of the region of stability along the negative real axis, times the step: about 0.65 s²."""
    return 2 / 3 * (stages**2 - 1) * (1 - 2 / 15 * _DAMPING)


def stages_for(stiffness: float) -> int:
    """The fewest stages with that extent (largest decay rate [1/s] times the step [s])."""
    return int(np.ceil(np.sqrt(1 + stiffness / reach(2) * 3)))


@cache
def chebyshev_coefficients(stages: int) -> Float64[np.ndarray, "S1 4"]:
    """μ, ν, μ̃, γ̃ of the stages 1…s (row 0 is unused) for increments over the start of the step.

    D_j = μ_j D_{j−1} + ν_j D_{j−2} + μ̃_j h F_{j−1} + γ̃_j h F_0, D_0 = 0 (Sommeijer, Shampine, Verwer 1997, RKC: an
    explicit solver for parabolic PDEs, eqs. 2.1–2.4).
    """
    w0 = 1 + _DAMPING / stages**2
    value, slope, bend = [1.0, w0], [0.0, 1.0], [0.0, 0.0]  # Chebyshev polynomials at w0, and derivatives
    for _ in range(2, stages + 1):
        bend.append(4 * slope[-1] + 2 * w0 * bend[-1] - bend[-2])
        slope.append(2 * value[-1] + 2 * w0 * slope[-1] - slope[-2])
        value.append(2 * w0 * value[-1] - value[-2])
    w1 = slope[stages] / bend[stages]
    b = [0.0, 0.0] + [bend[j] / slope[j] ** 2 for j in range(2, stages + 1)]
    b[0] = b[1] = b[2]
    a = [1 - b[j] * value[j] for j in range(stages + 1)]
    rows = np.zeros((stages + 1, 4))
    rows[1, 2] = b[1] * w1
    for j in range(2, stages + 1):
        new = 2 * b[j] * w1 / b[j - 1]
        rows[j] = 2 * b[j] * w0 / b[j - 1], -b[j] / b[j - 2], new, -a[j - 1] * new
    return rows
