"""The unknowns of an identification: name, start, bounds, Gaussian prior, and the length of a typical step.

The names are those of `physconvex.reduced.PARAMETERS`: Young's modulus enters as log10 E, everything else in SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError
from physconvex.reduced import PARAMETERS

_INF = float("inf")
_RATIO_LENGTH = 0.15
_LEAST_SLOPE = 1e-9  # of 1 − 2ν
# start, lowest, highest, typical step
_MATERIAL = {
    "log10_youngs_modulus": (5.0, 3.0, 8.0, 0.2),
    "poisson_ratio": (0.35, 0.0, 0.495, 0.1),
    "density": (1000.0, 10.0, 2e4, 100.0),
    "damping_time": (1e-3, 0.0, 0.1, 2e-3),
    "air_drag": (0.05, 0.0, 10.0, 0.1),
    "friction": (0.3, 1e-3, 2.0, 0.1),  # a frictionless floor has no derivative by it
    "floor_height": (0.0, -_INF, _INF, 0.01),
    "contact_damping": (1e-3, 1e-6, 0.5, 1e-3),
    "log10_contact_stiffness": (7.0, 3.0, 11.0, 0.3),
}
_VECTORS = {
    "gravity": 0.5,
    "wind": 0.5,
    "initial_velocity": 0.1,
    "initial_angular_velocity": 0.3,
    "initial_position": 0.01,
    "initial_orientation": 0.02,
}


@dataclass(frozen=True)
class Parameter:
    """One unknown.

    Attributes:
        name: of `physconvex.reduced.PARAMETERS`.
        start: where the search begins.
        lower, upper: bounds.
        step: length of a typical step, the unit of the search.
        prior_mean, prior_sigma: Gaussian prior; an infinite sigma means none.

    Raises:
        InputError: an unknown name, or a start outside the bounds.
    """

    name: str
    start: float
    lower: float = -_INF
    upper: float = _INF
    step: float = 1.0
    prior_mean: float = 0.0
    prior_sigma: float = _INF

    def __post_init__(self) -> None:
        if self.name not in PARAMETERS:
            raise InputError(f"parameter: got {self.name!r}; expected one of {', '.join(PARAMETERS)}")
        if not self.lower <= self.start <= self.upper:
            raise InputError(
                f"parameter {self.name}: starts at {self.start:g}; expected a value in [{self.lower:g}, {self.upper:g}]"
            )
        if not (self.step > 0 and self.prior_sigma > 0):
            raise InputError(f"parameter {self.name}: step and prior_sigma must be positive")

    def at(self, start: float) -> Parameter:
        """The same with another start, moved inside the bounds."""
        return replace(self, start=float(np.clip(start, self.lower, self.upper)))

    def held(self) -> Parameter:
        """The same, held fixed."""
        return replace(self, lower=self.start, upper=self.start)


def default_parameter(name: str, *, start: float | None = None) -> Parameter:
    """A parameter with the bounds and the step that suit its name.

    Raises:
        InputError: the name is unknown.
    """
    if name in _MATERIAL:
        usual, lower, upper, step = _MATERIAL[name]
        return Parameter(name, usual, lower, upper, step).at(usual if start is None else start)
    stem = name.rpartition("_")[0]
    if name not in PARAMETERS or stem not in _VECTORS:
        raise InputError(f"parameter: got {name!r}; expected one of {', '.join(PARAMETERS)}")
    return Parameter(name, 0.0 if start is None else start, step=_VECTORS[stem])


def starts(parameters: Sequence[Parameter]) -> Float[np.ndarray, " K"]:
    """Start values."""
    return np.array([p.start for p in parameters])


def lower_bounds(parameters: Sequence[Parameter]) -> Float[np.ndarray, " K"]:
    """Lowest values."""
    return np.array([p.lower for p in parameters])


def upper_bounds(parameters: Sequence[Parameter]) -> Float[np.ndarray, " K"]:
    """Highest values."""
    return np.array([p.upper for p in parameters])


def step_scales(parameters: Sequence[Parameter]) -> Float[np.ndarray, " K"]:
    """Typical steps."""
    return np.array([p.step for p in parameters])


class SearchCoordinates:
    """Coordinates in which the misfit's valleys are nearly straight; all but ν are their own coordinates.

    The stiffness against compression is λ = 2 μ ν/(1 − 2ν), which diverges at ν = ½. Along a valley of E and ν that
    explain a motion equally well, log E is nearly linear in log(1 − 2ν) but strongly curved in ν, where
    Levenberg–Marquardt is slow. So ν is searched as u = −0.15 log(1 − 2ν); at ν = 0.35 a step of u is a step of ν.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._bent = np.array([name == "poisson_ratio" for name in names], dtype=bool)

    def of(self, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
        """Coordinates of values."""
        out = np.array(values, dtype=np.float64)
        out[self._bent] = -_RATIO_LENGTH * np.log(np.maximum(1 - 2 * out[self._bent], _LEAST_SLOPE))
        return out

    def values(self, coordinates: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
        """Values of coordinates."""
        out = np.array(coordinates, dtype=np.float64)
        out[self._bent] = -0.5 * np.expm1(-out[self._bent] / _RATIO_LENGTH)
        return out

    def slopes(self, values: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
        """Derivatives of values by coordinates."""
        out = np.ones(len(values))
        out[self._bent] = np.maximum(1 - 2 * values[self._bent], _LEAST_SLOPE) / (2 * _RATIO_LENGTH)
        return out
