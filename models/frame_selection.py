"""Choose the frames that a clip of fixed rate and length shows of a video."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

_LEAD_FRAMES = 2  # shown before the motion begins
_THUMBNAIL = 64  # [px]


@dataclass(frozen=True)
class FrameSelection:
    """Indices of source frames, equally spaced in time at `fps`."""

    indices: Int64[np.ndarray, " N"]
    fps: float  # [1/s]


def resample(timestamps: Float64[np.ndarray, " T"], *, target_fps: float) -> FrameSelection:
    """Every n-th frame of a video of constant rate; the nearest frames of one with a variable rate.

    With a constant rate the spacing is exact: the result has the source rate divided by the whole number that brings it
    closest to `target_fps` (25 -> 25, 60 -> 30, 240 -> 24). A variable rate is sampled at `target_fps`, or at its mean
    rate if that is lower.
    """
    steps = np.diff(timestamps)
    rate = len(steps) / (timestamps[-1] - timestamps[0])
    if np.ptp(steps) <= 0.25 * np.median(steps):
        stride = max(1, round(rate / target_fps))
        return FrameSelection(indices=np.arange(0, len(timestamps), stride), fps=float(rate / stride))
    fps = float(min(rate, target_fps))
    times = timestamps[0] + np.arange(int((timestamps[-1] - timestamps[0]) * fps + 1e-6) + 1) / fps
    middles = (timestamps[1:] + timestamps[:-1]) / 2
    return FrameSelection(indices=np.searchsorted(middles, times).astype(np.int64), fps=fps)


def motion_start(frames: UInt8[np.ndarray, "T H W 3"], indices: Int64[np.ndarray, " N"], *, length: int) -> int:
    """Position in `indices` at which a window of `length` frames begins: just before the motion.

    Motion is a change above the noise in a thumbnail's frame differences. Without motion the result is 0; the window
    never extends beyond the last frame.
    """
    size = (_THUMBNAIL, _THUMBNAIL)
    small = [cv2.resize(frames[i], size, interpolation=cv2.INTER_AREA).mean(axis=2) for i in indices]
    change = np.abs(np.diff(np.stack(small).astype(np.float32), axis=0)).reshape(len(small) - 1, -1)
    strength = np.partition(change, -20, axis=1)[:, -20]  # the 20th largest of 4096 pixels
    threshold = max(6.0, 3.0 * float(np.quantile(strength, 0.1)))
    moving = np.flatnonzero(strength > threshold)
    first = int(moving[0]) if len(moving) else 0
    return max(0, min(first - _LEAD_FRAMES, len(indices) - length))
