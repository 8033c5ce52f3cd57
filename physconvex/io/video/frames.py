"""Result of reading a video."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8


@dataclass(frozen=True)
class Video:
    """Decoded frames, upright (rotation metadata applied), 8-bit RGB.

    `timestamps` are seconds since the first frame. With a variable rate they are not equidistant and `fps` is the mean
    rate. `alpha` is None unless some pixel is not opaque. `truncated` states in one line what is missing if the file is
    truncated or damaged (also a warning), else it is empty.
    """

    frames: UInt8[np.ndarray, "T H W 3"]
    fps: float  # [1/s]
    timestamps: Float64[np.ndarray, " T"]  # [s]
    alpha: UInt8[np.ndarray, "T H W"] | None = None
    warnings: tuple[str, ...] = ()
    truncated: str = ""


def frame_rate(timestamps: Float64[np.ndarray, " T"]) -> float:
    """Mean rate [1/s] of two or more increasing times [s]."""
    return float((len(timestamps) - 1) / (timestamps[-1] - timestamps[0]))
