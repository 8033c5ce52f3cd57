"""Constants of a material, given as one number or one for each part of a body."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.errors import InputError

_BOUNDS = {"youngs_modulus": (0.0, np.inf), "poisson_ratio": (-1.0, 0.5), "density": (0.0, np.inf)}


def checked_constant(
    name: str, value: float | Float[np.ndarray, ...], shape: tuple[int, ...]
) -> Float[np.ndarray, ...]:
    """The values of E [Pa], ν [-] or ρ [kg/m³], of a shape.

    Raises:
        InputError: values of another shape or out of the range of the constant of that name.
    """
    array, (low, high) = np.asarray(value, dtype=np.float64), _BOUNDS[name]
    if array.shape not in ((), shape):
        raise InputError(f"{name}: got shape {array.shape}; expected a number or {list(shape)}")
    if not ((array > low) & (array < high)).all():
        raise InputError(f"{name}: got values in [{array.min()}, {array.max()}]; expected inside ({low}, {high})")
    return np.broadcast_to(array, shape).copy()
