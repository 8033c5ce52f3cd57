"""Light, floor and background of a rendered object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8


@dataclass(frozen=True)
class Lighting:
    """One key light far away, a fill light from the other side, ambient light and the floor's reflection.

    Attributes:
        direction: unit vector from the scene to the key light, shape [3], z > 0.
        key, fill, ambient: intensities, factors on the texture colour.
        color: RGB factor of the key light.
        specular: strength of the highlight.
        bounce: light from straight below, a factor on `ambient`.
        shadow_softness: standard deviation of the shadow's edge, in image heights.
    """

    direction: tuple[float, float, float]
    key: float = 0.8
    fill: float = 0.25
    ambient: float = 0.35
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    specular: float = 0.1
    shadow_softness: float = 0.01
    bounce: float = 0.5


@dataclass(frozen=True, eq=False)
class Backdrop:
    """Floor (plane z = 0) and background.

    Attributes:
        floor: texture, shape [h, w, 3] uint8, one tile of edge `floor_tile` [m].
        background: picture of the far surroundings, shape [h, w, 3] uint8 (row 0 is up).
    """

    floor: UInt8[np.ndarray, "h w 3"]
    background: UInt8[np.ndarray, "h2 w2 3"]
    floor_tile: float = 1.0
