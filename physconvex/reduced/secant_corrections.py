"""Secant corrections (L-BFGS) of a stale factorisation.

A factor is kept over many time steps. The two-loop recursion (Nocedal & Wright 2006, algorithm 7.4, with the factor as
the initial inverse) corrects it with the gradients evaluated since. Steps then converge faster than linearly, so that
the factor lasts longer. Each loop is a triangular system here, of the products of the changes of place S with those of
gradient Y: with R the upper triangle of S Yᵀ and D its diagonal, R a = S r, q = r − Yᵀ a, Rᵀ b = D a − Y K⁻¹ q, and K⁻¹
q + Sᵀ b is the result.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg.blas import dtrsv

_CURVED = 1e-8  # cosine between change of place and of gradient below which a pair is ignored


class Secants:
    """Pairs of changes of place and of gradient; the oldest are dropped.

    Args:
        memory: number of pairs kept.
        smallest: largest component of a change of place below which its change of gradient counts as rounding.
    """

    def __init__(self, memory: int, *, smallest: float) -> None:
        self._memory, self._smallest = memory, smallest
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self.forget()

    def forget(self) -> None:
        """Drop all pairs: there is a new factor."""
        self._places, self._gradients = np.zeros((0, 0)), np.zeros((0, 0))  # S and Y, the oldest first
        self._products = np.zeros((0, 0), order="F")  # S Yᵀ, its upper triangle

    def interrupt(self) -> None:
        """The function changes: the next gradient has nothing to do with the last one."""
        self._last = None

    def note(self, x: np.ndarray, gradient: np.ndarray) -> None:
        """Update with a gradient."""
        if self._last is not None:
            s, y = (x - self._last[0]).ravel(), (gradient - self._last[1]).ravel()
            product = float(s @ y)
            if np.abs(s).max() > self._smallest and product > _CURVED * np.sqrt(float(s @ s) * float(y @ y)):
                self._keep(s, y, product)
        self._last = (x, gradient)

    def _keep(self, s: np.ndarray, y: np.ndarray, product: float) -> None:
        first = max(len(self._places) + 1 - self._memory, 0)
        kept = self._places[first:].reshape(-1, len(s))
        count = len(kept)
        products = np.zeros((count + 1, count + 1), order="F")
        products[:count, :count] = self._products[first:, first:]
        products[:count, count], products[count, count] = kept @ y, product
        self._products = products
        self._places = np.concatenate([kept, s[None]])
        self._gradients = np.concatenate([self._gradients[first:].reshape(-1, len(s)), y[None]])

    def solve(self, inverse: Callable[[np.ndarray], np.ndarray], rhs: np.ndarray) -> np.ndarray:
        """Apply the corrected inverse to a vector."""
        if not len(self._places):
            return inverse(rhs)
        shares = dtrsv(self._products, self._places @ rhs)
        out = inverse(rhs - shares @ self._gradients)
        back = dtrsv(self._products, self._products.diagonal() * shares - self._gradients @ out, trans=1)
        return out + back @ self._places
