"""Moving region in the pictures of a fixed camera."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8

from models.appearance import sort_pictures
from models.shapes import clean_mask

Window = tuple[slice, slice]  # rows and columns

_LEAST_CONTRAST = 7.0  # of 255
_LEAST_MOVED, _MOST_MOVED = 0.002, 0.6  # share of the picture that a moving object may change
_MARGIN = 8  # [px]


def moving_window(frames: UInt8[np.ndarray, "T H W 3"], *, margin: int = _MARGIN) -> Window | None:
    """Rows and columns around all changes; None without changes, or if most of the picture changes.

    A change exceeds the noise: 4.5 times the usual difference of a pixel between frames.
    """
    smooth = np.stack([cv2.GaussianBlur(frame, (3, 3), 0.7) for frame in frames])
    threshold = noise_level(smooth)
    moved = np.stack([_largest(cv2.absdiff(image, smooth[0])) for image in smooth]) > threshold
    share = float(moved.reshape(len(frames), -1).mean(axis=1).max())
    if not _LEAST_MOVED <= share <= _MOST_MOVED:
        return None
    activity = np.asarray(moved.any(axis=0))
    cleaned = clean_mask(activity)
    x, y, width, height = cv2.boundingRect((cleaned if cleaned.any() else activity).astype(np.uint8))
    rows = slice(max(0, y - margin), min(frames.shape[1], y + height + margin))
    return rows, slice(max(0, x - margin), min(frames.shape[2], x + width + margin))


def noise_level(smooth: UInt8[np.ndarray, "T H W 3"]) -> UInt8[np.ndarray, "H W"]:
    """Threshold above the noise: 4.5 times the usual difference of the pixel between frames."""
    last = len(smooth) - 1
    steps = [_largest(cv2.absdiff(smooth[k + 1], smooth[k])) for k in range(0, last, max(1, last // 8))]
    middle = sort_pictures(steps)[len(steps) // 2].astype(np.float32)
    local = cv2.blur(middle, (3, 3))
    threshold = np.clip(np.maximum(4.5 * float(np.median(local)), 3.5 * local), _LEAST_CONTRAST, 40.0)
    return threshold.astype(np.uint8)


def _largest(image: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W"]:
    return np.maximum(np.maximum(image[..., 0], image[..., 1]), image[..., 2])
