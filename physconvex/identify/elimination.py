"""Gaussian unknowns eliminated from residuals: whitening by the covariance that they add."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["Elimination"]


@dataclass(frozen=True, eq=False)
class Elimination:
    """(I + N Nᵀ)^(−½) and the determinant, by the singular values of N.

    Attributes:
        left: left singular vectors, shape [N, C].
        values: singular values, shape [C].
    """

    left: Float[np.ndarray, "N C"]
    values: Float[np.ndarray, " C"]

    @classmethod
    def of(cls, directions: Float[np.ndarray, "N C"]) -> Elimination:
        """Of unknowns with unit variance, the columns of N the residuals' derivatives by them."""
        if not directions.shape[1]:
            return cls(np.zeros_like(directions), np.zeros(0))
        left, values, _ = np.linalg.svd(directions, full_matrices=False)
        return cls(left, values)

    def whitened(self, columns: Float[np.ndarray, "N K"]) -> Float[np.ndarray, "N K"]:
        """(I + N Nᵀ)^(−½) times the columns."""
        shrunk = 1 / np.sqrt(1 + self.values**2) - 1
        return np.asarray(columns + self.left @ (shrunk[:, None] * (self.left.T @ columns)))

    @property
    def log_determinant(self) -> float:
        """log det(I + N Nᵀ)."""
        return float(np.log1p(self.values**2).sum())
