"""Windows that follow the object, of the same size everywhere, so that only its shape changes in them."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

GREY = 127  # colour of everything but the object

_FRAMES_FOR_UNIT = 3
_LEAST_AREA = 1.0  # [px]


def object_windows(
    frames: UInt8[np.ndarray, "T S S 3"], mask: UInt8[np.ndarray, "T S S"], *, size: int, extent: float
) -> UInt8[np.ndarray, "T W W 4"]:
    """Square windows about the silhouette's centroid: RGB, and the object's coverage 0..255.

    Args:
        frames: grey outside the object.
        mask: coverage 0..255.
        size: edge of the result [px].
        extent: edge of a window in units of the silhouette's larger edge, median over the first three frames.

    A frame without a silhouette is shown at the place of the one before it (leading ones: at that of the first).
    Without any silhouette all windows show the middle of the picture.
    """
    edge = extent * _unit(mask)
    step = edge / size
    pictures = np.concatenate([frames, mask[..., None]], axis=3)
    windows = np.empty((len(mask), size, size, 4), np.uint8)
    for k, (x, y) in enumerate(_centroids(mask) - edge / 2 + step / 2 - 0.5):  # of the first pixel's centre
        matrix = np.array([[step, 0, x], [0, step, y]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        windows[k] = cv2.warpAffine(pictures[k], matrix, (size, size), flags=flags, borderValue=(GREY, GREY, GREY, 0))
    return windows


def _unit(mask: UInt8[np.ndarray, "T S S"]) -> float:
    """Larger edge of the silhouette's box [px], median over the first frames that hold one."""
    edges = [max(cv2.boundingRect((frame > 127).astype(np.uint8))[2:]) for frame in mask]
    seen = [edge for edge in edges if edge > 0][:_FRAMES_FOR_UNIT]
    return max(float(np.median(seen)), 4.0) if seen else mask.shape[1] / 2


def _centroids(mask: UInt8[np.ndarray, "T S S"]) -> Float64[np.ndarray, "T 2"]:
    """x, y [px], pixel centres at +0.5."""
    side = mask.shape[1]
    moments = [cv2.moments(frame) for frame in mask]
    seen = np.flatnonzero([m["m00"] >= 255 * _LEAST_AREA for m in moments])
    if len(seen) == 0:
        return np.full((len(mask), 2), side / 2)
    centres = np.array([(moments[k]["m10"], moments[k]["m01"]) for k in seen])
    centres = centres / np.array([moments[k]["m00"] for k in seen])[:, None] + 0.5
    return centres[np.maximum(np.searchsorted(seen, np.arange(len(mask)), side="right") - 1, 0)]
