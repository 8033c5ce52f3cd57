"""Dimensionless numbers of a soft body under gravity, and back to SI.

The motion of a body of size L and density ρ under gravity g, in the time unit √(L/g), depends only on ν and E/(ρ g L)
(Buckingham). A clip without scale determines only these, so that the network reads and predicts them. The same frames
with twice L and fps/√2 therefore give exactly twice E.
"""

from typing import TypeVar

import numpy as np
from jaxtyping import Float64

from physconvex import InputError

GRAVITY = 9.81  # [m/s²]

Number = TypeVar("Number", float, Float64[np.ndarray, "..."])


def log10_dimensionless_stiffness(
    youngs_modulus: Number, *, density: Number, object_size: Number, gravity: float = GRAVITY
) -> Number:
    """log10(E / (ρ g L)) of Young's modulus E [Pa], density ρ [kg/m³], largest rest edge L [m].

    >>> float(round(log10_dimensionless_stiffness(9810.0, density=1000.0, object_size=1.0), 12))
    0.0
    """
    _require_positive(youngs_modulus=youngs_modulus, density=density, object_size=object_size)
    return np.log10(youngs_modulus / (density * gravity * object_size))


def log10_youngs_modulus(
    log10_stiffness: Number, *, density: Number, object_size: Number, gravity: float = GRAVITY
) -> Number:
    """log10(E / Pa) from log10(E / (ρ g L)); the inverse of `log10_dimensionless_stiffness`."""
    _require_positive(density=density, object_size=object_size)
    return log10_stiffness + np.log10(density * gravity * object_size)


def dimensionless_interval(fps: Number, *, object_size: Number, gravity: float = GRAVITY) -> Number:
    """Time between two frames, Δt √(g/L), for `fps` [1/s] and size L [m]."""
    _require_positive(fps=fps, object_size=object_size)
    return np.sqrt(gravity / object_size) / fps


def _require_positive(**values: object) -> None:
    for name, value in values.items():
        array = np.asarray(value)
        if not (np.isfinite(array).all() and (array > 0).all()):
            raise InputError(f"{name}: got {value!r}; expected positive, finite numbers in SI units")
