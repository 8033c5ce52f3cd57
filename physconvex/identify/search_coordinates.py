"""Coordinates in which a search goes straight where values bend.

What a body resists besides shear is λ = 2 μ ν/(1 − 2ν), which grows without end towards ν = ½: along a valley of E and
ν that all explain a motion, log E is nearly linear in log(1 − 2ν), and in ν a hook that Levenberg–Marquardt must creep
around. So ν is searched as u = −0.15 log(1 − 2ν), a step of which is a step of ν at ν = .35.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

__all__ = ["SearchCoordinates"]

_LENGTH = 0.15
_LEAST = 1e-9  # of 1 − 2ν


class SearchCoordinates:
    """Of parameters with these names; all but ν are their own coordinates."""

    def __init__(self, names: Sequence[str]) -> None:
        self._bent = np.array([name == "poisson_ratio" for name in names], dtype=bool)

    def of(self, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
        """Coordinates of values."""
        out = np.array(values, dtype=np.float64)
        out[self._bent] = -_LENGTH * np.log(np.maximum(1 - 2 * out[self._bent], _LEAST))
        return out

    def values(self, coordinates: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
        """Values of coordinates."""
        out = np.array(coordinates, dtype=np.float64)
        out[self._bent] = -0.5 * np.expm1(-out[self._bent] / _LENGTH)
        return out

    def slopes(self, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
        """Derivatives of values by coordinates."""
        out = np.ones(len(values))
        out[self._bent] = np.maximum(1 - 2 * values[self._bent], _LEAST) / (2 * _LENGTH)
        return out
