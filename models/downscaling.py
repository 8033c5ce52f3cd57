"""Pictures made smaller by area averages, quickly."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8


def halvings(edge: int, target: int) -> int:
    """Number of times an edge can be halved and stay at least as long as `target`."""
    return max(0, (edge // target).bit_length() - 1)


def shrink(picture: UInt8[np.ndarray, "H W ..."], size: tuple[int, int]) -> UInt8[np.ndarray, "h w ..."]:
    """Area average in `size` (width, height).

    First all halvings that divide the edges, in one step: a whole factor is much faster than another one.
    """
    height, width = picture.shape[:2]
    times = min(halvings(width, size[0]), halvings(height, size[1]))
    factor = 2**times
    while width % factor or height % factor:
        factor //= 2
    if factor > 1:
        picture = cv2.resize(picture, (width // factor, height // factor), interpolation=cv2.INTER_AREA)
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
