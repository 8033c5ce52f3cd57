"""Result of reading a video, and one error per way in which a video can be bad."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64, UInt8

from physconvex.errors import InputError

VideoCause = Literal[
    "missing",
    "permission",
    "empty_file",
    "not_a_video",
    "no_video_stream",
    "truncated",
    "too_few_frames",
    "too_large",
    "undecodable",
]


class VideoError(InputError):
    """A video that cannot be read.

    The message is one line that names the file, what is wrong and the remedy; `cause` is one word of
    a closed set, for programs.
    """

    def __init__(self, path: Path | str, cause: VideoCause, detail: str) -> None:
        super().__init__(f"{path}: {detail} [{cause}]")
        self.path = Path(path)
        self.cause: VideoCause = cause
        self.detail = detail

    def __reduce__(self) -> tuple[type[VideoError], tuple[Path, VideoCause, str]]:
        """Lets the error be pickled between processes (the default passes the message as the only argument)."""
        return type(self), (self.path, self.cause, self.detail)


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
