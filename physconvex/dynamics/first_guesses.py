"""Errors of the first guesses of a roll-out's time steps, which correct those of roll-outs that differ little from it.

Newton's method begins each step at positions extrapolated from earlier states. Another roll-out with nearly the same
parameters makes nearly the same error, so adding the recorded one leaves a small error of a small difference.
"""

from __future__ import annotations

import numpy as np

_GRAIN = 1e-9  # times nearer than that are the same [s]


class GuessErrors:
    """Misses [m] of the steps of one roll-out, known by when a step ended and how long it was."""

    def __init__(self) -> None:
        self._missed: dict[tuple[int, int], np.ndarray] = {}

    def note(self, time: float, step: float, missed: np.ndarray) -> None:
        """A step that ended at a time [s] and was so long [s] missed by so much [m]."""
        self._missed[_key(time, step)] = missed

    def corrected(self, guess: np.ndarray, time: float, step: float) -> np.ndarray:
        """The first guess [m] of a step, with what was missed there, if such a step was made."""
        missed = self._missed.get(_key(time, step))
        return guess if missed is None else guess + missed

    def __len__(self) -> int:
        """Number of steps."""
        return len(self._missed)


def _key(time: float, step: float) -> tuple[int, int]:
    return round(time / _GRAIN), round(step / _GRAIN)
