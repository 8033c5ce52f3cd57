"""Material points of a body that are held, or moved along a path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError


@dataclass(frozen=True)
class Pins:
    """Points that are held or moved.

    Finite elements hold the nodes at these points exactly. A reduced body is held by springs of the energy ½ Σ k A
    |φ(X) − x*(t)|²: an exactly clamped face removes every shape function that does not vanish on it.

    Attributes:
        points: rest positions of the points [m], shape [C, 3].
        areas: boundary area of each [m²], shape [C], or one for all.
        motion: x*(t) [m] as a function of time [s], shape [C, 3]; None holds the points at their start.
        stiffness: k [Pa/m] of the springs; 1000 × (largest E) / (size of the body) unless given.

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
