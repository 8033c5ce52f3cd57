"""Pins and handles: material points of a body that are held, or led along a path, by springs.

A clamped face would, exactly, take away every shape function that does not vanish on it, and a reduced body of few
functions could then not deform near it at all. Springs with a stiffness per area instead leave the compliance
E/(k L) of the displacements, which their default stiffness keeps at a thousandth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError

__all__ = ["PIN_STIFFNESS_RATIO", "PinSprings", "Pins"]

PIN_STIFFNESS_RATIO = 1000.0  # k L / E: a clamp gives way by about a thousandth of the body's displacements


@dataclass(frozen=True)
class Pins:
    """Points that are held or led: the energy is ½ Σ k A |φ(X) − x*(t)|².

    Attributes:
        points: rest positions of the points [m], shape [C, 3].
        areas: boundary area that each of them stands for [m²], shape [C], or one for all.
        motion: x*(t) [m] as a function of time [s], shape [C, 3]; None holds the points where they start.
        stiffness: k [Pa/m]; 1000 × (largest E) / (size of the body) unless given.

    Raises:
        InputError: a wrong shape or range.
    """

    points: Float[np.ndarray, "C 3"]
    areas: float | Float[np.ndarray, " C"]
    motion: Callable[[float], Float[np.ndarray, "C 3"]] | None = None
    stiffness: float | None = None

    def __post_init__(self) -> None:
        points = np.asarray(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
            raise InputError(f"pins.points: got shape {points.shape}; expected finite [C, 3] in metres, C > 0")
        areas = np.asarray(self.areas, dtype=np.float64)
        if areas.shape not in ((), (len(points),)) or not (np.isfinite(areas) & (areas > 0)).all():
            raise InputError(f"pins.areas: got shape {areas.shape}; expected a number or [{len(points)}], > 0 in m²")
        if self.stiffness is not None and not (np.isfinite(self.stiffness) and self.stiffness > 0):
            raise InputError(f"pins.stiffness: got {self.stiffness}; expected a finite number > 0 in Pa/m")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "areas", np.broadcast_to(areas, len(points)).copy())


@dataclass(frozen=True)
class PinSprings:
    """The springs of pins on a reduced body.

    Attributes:
        values: shape functions at the points, shape [C, R].
        weights: k A [N/m], shape [C].
        anchors: where the points start [m], shape [C, 3].
        motion: as in `Pins`.
    """

    values: Float[np.ndarray, "C R"]
    weights: Float[np.ndarray, " C"]
    anchors: Float[np.ndarray, "C 3"]
    motion: Callable[[float], Float[np.ndarray, "C 3"]] | None

    @cached_property
    def matrix(self) -> Float[np.ndarray, "R R"]:
        """Second derivative of the energy, the same for each coordinate [N/m]."""
        return self.values.T @ (self.weights[:, None] * self.values)

    def targets(self, time: float) -> Float[np.ndarray, "C 3"]:
        """x*(t) [m].

        Raises:
            InputError: `motion` gave another shape than [C, 3], or values that are not finite.
        """
        if self.motion is None:
            return self.anchors
        targets = np.asarray(self.motion(time), dtype=np.float64)
        if targets.shape != self.anchors.shape or not np.isfinite(targets).all():
            raise InputError(
                f"pins.motion: got shape {targets.shape} at t = {time:g} s; expected finite positions [m] of shape "
                f"{self.anchors.shape}, one row per point"
            )
        return targets

    def pull(self, x: Float[np.ndarray, "R 3"], time: float) -> Float[np.ndarray, "C 3"]:
        """Force of each spring on the body [N] at coordinates x [m]."""
        return self.weights[:, None] * (self.targets(time) - self.values @ x)

    def energy_and_gradient(self, x: Float[np.ndarray, "R 3"], time: float) -> tuple[float, Float[np.ndarray, "R 3"]]:
        """Energy [J] and its derivative with respect to the coordinates [N]."""
        force = self.pull(x, time)
        return 0.5 * float((force**2 / self.weights[:, None]).sum()), -(self.values.T @ force)
