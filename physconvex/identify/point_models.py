"""Models of a fit: from parameter values to positions of material points; models composed of others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from physconvex.errors import ConvergenceError, InputError
from physconvex.numerics import broyden_update, moved_along

Values = Float[np.ndarray, " K"]
Positions = Float[np.ndarray, "T P 3"]
"""Of P points in T frames [m]."""
Tangents = Float[np.ndarray, "T K P 3"]
"""Derivatives of positions by K values."""


@runtime_checkable
class PointModel(Protocol):
    """Positions of chosen points in all frames by named parameters, and their derivatives.

    The reduced and the full simulator implement it (`physconvex.identify.model`), as do the composed models below and a
    twin with effects (`physconvex.gap`).
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the K parameters."""

    def positions(self, values: Values) -> Positions:
        """Positions of the points at the frames [m]."""

    def linearise(self, values: Values) -> tuple[Positions, Tangents]:
        """Positions and their derivatives by the parameters."""


@dataclass(frozen=True, eq=False)
class LinearModel:
    """A linearisation: positions and tangents at one set of values.

    Attributes:
        names: the parameters.
        anchor: the values, shape [K].
        at: positions there [m], shape [T, P, 3].
        tangents: their derivatives there, shape [T, K, P, 3].
    """

    names: tuple[str, ...]
    anchor: Values
    at: Positions
    tangents: Tangents

    def positions(self, values: Values) -> Positions:
        """Positions of the points at the frames [m]."""
        return self.at + moved_along(self.tangents, values - self.anchor)

    def linearise(self, values: Values) -> tuple[Positions, Tangents]:
        """Positions and the derivatives."""
        return self.positions(values), self.tangents


@dataclass(frozen=True, eq=False)
class CorrectedModel:
    """A model shifted by the difference to another one at one set of values.

    Attributes:
        model: the cheap model.
        anchor: values at which the shift is exact, shape [K].
        shift: δ [m], shape [T, P, 3].
        slope: D, shape [T, K, P, 3].
    """

    model: PointModel
    anchor: Values
    shift: Positions
    slope: Tangents

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.model.names

    def _correction(self, values: np.ndarray) -> np.ndarray:
        return self.shift + moved_along(self.slope, values - self.anchor)

    def positions(self, values: Values) -> Positions:
        """Corrected positions [m]."""
        return self.model.positions(values) + self._correction(values)

    def linearise(self, values: Values) -> tuple[Positions, Tangents]:
        """Corrected positions and their derivatives."""
        positions, tangents = self.model.linearise(values)
        return positions + self._correction(values), tangents + self.slope


class SecantModel:
    """A model with derivatives by Broyden's update: one run per linearisation.

    Args:
        model: gives positions.
        values: where the derivatives are computed, shape [K].
        positions: there [m], shape [T, P, 3].
        tangents: the derivatives, shape [T, K, P, 3].
        scales: typical steps of the parameters, shape [K].
        check: called before each run; it ends a fit by raising ConvergenceError.
    """

    def __init__(
        self,
        model: PointModel,
        values: Values,
        positions: Positions,
        tangents: Tangents,
        *,
        scales: Values,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self.model, self.tangents, self.scales, self.check = model, tangents, scales, check
        self._last = values.copy(), positions

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.model.names

    def positions(self, values: Values) -> Positions:
        """Positions of the points at the frames [m]."""
        return self.model.positions(values)

    def linearise(self, values: Values) -> tuple[Positions, Tangents]:
        """Positions, and the derivatives updated with the last step.

        Raises:
            ConvergenceError: the model cannot be run there, or `check` ends the fit.
        """
        old, before = self._last
        if np.array_equal(values, old):
            return before, self.tangents
        self.check()
        positions = self.model.positions(values)
        if not np.isfinite(positions).all():
            raise ConvergenceError("the motion is not finite")
        self.tangents = broyden_update(self.tangents, values - old, positions - before, self.scales, still=0.0)
        self._last = values.copy(), positions
        return positions, self.tangents


def check_names(names: Sequence[str], expected: Sequence[str]) -> None:
    """Check that a model and a list of parameters have the same unknowns in the same order.

    Raises:
        InputError: they do not.
    """
    if tuple(names) != tuple(expected):
        raise InputError(f"parameters: got {list(expected)}; expected those of the model, {list(names)}")
