"""Stiffness and dashpot of the floor as base parameters: a capture states neither.

They join E, ν and the initial motion where a recording shows that its floor gives way, see
`physconvex.gap.giving_floor`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.identify import Parameter, Twin
from physconvex.identify.parameters import default_parameter
from physconvex.reduced import parameter_values

__all__ = ["FLOOR_LAW", "NamedParameter", "base_parameter", "base_values", "twin_at"]

_DASHPOT = "contact_damping"
FLOOR_LAW = ("log10_contact_stiffness", _DASHPOT)
_LONGEST, _STEP = 0.5, 1e-3  # bound and typical step of the dashpot's time [s]


@dataclass(frozen=True)
class NamedParameter(Parameter):
    """An unknown whose name is none of `physconvex.reduced.PARAMETERS`."""

    def __post_init__(self) -> None:
        assert self.lower <= self.start <= self.upper and self.step > 0


def base_parameter(name: str, value: float) -> Parameter:
    """A base parameter that starts at a value, moved inside its bounds."""
    if name == _DASHPOT:
        return NamedParameter(name, float(np.clip(value, 0.0, _LONGEST)), 0.0, _LONGEST, _STEP)
    return default_parameter(name).at(value)


def base_values(twin: Twin, names: Sequence[str]) -> Float[np.ndarray, " K"]:
    """Present values of base parameters."""
    return np.array(
        [twin.scene.contact_damping if n == _DASHPOT else parameter_values(twin.scene, [n])[0] for n in names]
    )


def twin_at(twin: Twin, names: Sequence[str], values: Float[np.ndarray, " N"]) -> Twin:
    """The twin with base parameters set; values beyond the names are doses and left alone."""
    given = dict(zip(names, values[: len(names)], strict=True))
    dashpot = given.pop(_DASHPOT, None)
    if given:
        twin = twin.with_values(tuple(given), np.array(list(given.values())))
    return twin if dashpot is None else twin.with_scene(contact_damping=max(float(dashpot), 0.0))
