"""Errors of the first guesses of a roll-out's time steps; they correct those of similar roll-outs.

Newton's method begins each step at positions extrapolated from earlier states. Another roll-out with nearly the same
parameters makes nearly the same error, so that adding the recorded error leaves a small one.
"""

from __future__ import annotations

import numpy as np

_GRAIN = 1e-9  # times closer than this are the same [s]


class GuessErrors:
    """Errors [m] of the first guesses of one roll-out, indexed by end and length of the step."""

    def __init__(self) -> None:
        self._missed: dict[tuple[int, int], np.ndarray] = {}

    def note(self, time: float, step: float, missed: np.ndarray) -> None:
        """Store the error [m] of a step with that end [s] and length [s]."""
        self._missed[_key(time, step)] = missed

    def corrected(self, guess: np.ndarray, time: float, step: float) -> np.ndarray:
        """The first guess [m] of a step, corrected by the recorded error if there is one."""
        missed = self._missed.get(_key(time, step))
        return guess if missed is None else guess + missed

    def __len__(self) -> int:
        """Number of steps."""
        return len(self._missed)


def _key(time: float, step: float) -> tuple[int, int]:
    return round(time / _GRAIN), round(step / _GRAIN)
