"""Displacement of something that moves with a given velocity, constant or any function of time."""

from __future__ import annotations

from bisect import bisect_right, insort
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError

Velocity = Sequence[float] | Float[np.ndarray, " 3"] | Callable[[float], Sequence[float] | Float[np.ndarray, " 3"]]

_PANEL = 2e-3  # s, longest piece of the integral
# three points, degree 5 (Gauss–Legendre on [0, 1])
_NODES = 0.5 + 0.5 * np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


class MotionPath:
    """Velocity [m/s] and its integral from t = 0 [m].

    A function is integrated in pieces of at most 2 ms, from the nearest earlier time of evaluation.

    Args:
        velocity: three numbers, or a function of time [s] that gives them.

    Raises:
        InputError: anything but three finite numbers, now or when the function is called.
    """

    def __init__(self, velocity: Velocity) -> None:
        self._velocity = velocity if callable(velocity) else _three(velocity, "")
        self._times, self._displacements = [0.0], {0.0: np.zeros(3)}

    def velocity(self, time: float) -> Float[np.ndarray, " 3"]:
        """Velocity at a time [m/s]."""
        if callable(self._velocity):
            return _three(self._velocity(time), f" at t = {time:g} s")
        return self._velocity

    def displacement(self, time: float) -> Float[np.ndarray, " 3"]:
        """∫₀ᵗ v dt [m]."""
        if not callable(self._velocity):
            return time * self._velocity
        if time not in self._displacements:
            last = self._times[max(bisect_right(self._times, time) - 1, 0)]
            self._displacements[time] = self._displacements[last] + self._integral(last, time)
            insort(self._times, time)
        return self._displacements[time]

    def _integral(self, start: float, end: float) -> np.ndarray:
        edges = np.linspace(start, end, 1 + max(int(np.ceil(abs(end - start) / _PANEL)), 1))
        total = np.zeros(3)
        for left, right in pairwise(edges):
            values = np.stack([self.velocity(float(left + (right - left) * node)) for node in _NODES])
            total += (right - left) * (_WEIGHTS @ values)
        return total


def _three(value: Sequence[float] | np.ndarray, where: str) -> np.ndarray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(
            f"velocity: got {value!r}{where}; expected three finite numbers, or a function that gives them"
        )
    return array
