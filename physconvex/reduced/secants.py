"""Secant corrections (L-BFGS) of a stale factorisation.

A factor is kept over many time steps. What the gradients met since then tell of the Hessian is laid over it by the
two-loop recursion (Nocedal & Wright 2006, algorithm 7.4, with the factor as the initial inverse): steps then shrink
faster than linearly, so that the factor lasts longer.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

__all__ = ["Secants"]

_CURVED = 1e-8  # cosine between change of place and of gradient below which a pair tells nothing


class Secants:
    """Pairs of changes of place and of gradient, the last ones first forgotten when there are too many.

    Args:
        memory: number of pairs kept.
        smallest: largest component of a change of place below which its change of gradient is taken for rounding.
    """

    def __init__(self, memory: int, *, smallest: float) -> None:
        self._smallest = smallest
        self._pairs: deque[tuple[np.ndarray, np.ndarray, float]] = deque(maxlen=memory)
        self._last: tuple[np.ndarray, np.ndarray] | None = None

    def forget(self) -> None:
        """Drop all pairs: there is a new factor."""
        self._pairs.clear()

    def interrupt(self) -> None:
        """The function changes: the next gradient has nothing to do with the last one."""
        self._last = None

    def note(self, x: np.ndarray, gradient: np.ndarray) -> None:
        """Learn from a gradient."""
        if self._last is not None:
            s, y = (x - self._last[0]).ravel(), (gradient - self._last[1]).ravel()
            product = float(s @ y)
            if np.abs(s).max() > self._smallest and product > _CURVED * np.sqrt(float(s @ s) * float(y @ y)):
                self._pairs.append((s, y, product))
        self._last = (x, gradient)

    def solve(self, inverse: Callable[[np.ndarray], np.ndarray], rhs: np.ndarray) -> np.ndarray:
        """Apply the corrected inverse to a vector."""
        if not self._pairs:
            return inverse(rhs)
        q, shares = rhs.copy(), []
        for s, y, product in reversed(self._pairs):
            shares.append(float(s @ q) / product)
            q -= shares[-1] * y
        out = inverse(q)
        for (s, y, product), share in zip(self._pairs, reversed(shares), strict=True):
            out += (share - float(y @ out) / product) * s
        return out
