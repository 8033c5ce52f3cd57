"""Silhouette in front of a plain background."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from models.appearance import colour_planes, difference
from models.shapes import clean_mask, link_masks

_PLAIN_CONTRAST = 14.0  # of 255


def plain_background_masks(frames: UInt8[np.ndarray, "T H W 3"]) -> Bool[np.ndarray, "T H W"] | None:
    """The difference from a smooth colour field.

    The field is fitted to the picture's border; None if the border is not plain.
    """
    planes = colour_planes(frames)
    height, width = planes.shape[2:]
    border = np.ones((height, width), bool)
    rim = max(2, min(height, width) // 16)
    border[rim:-rim, rim:-rim] = False
    image = np.median(planes[:, :: max(1, len(frames) // 5)], axis=1)
    fitted = _fitted(image, border)
    residual = difference(image, fitted)
    threshold = max(_PLAIN_CONTRAST, 3.0 * float(np.quantile(residual[border], 0.8)))
    if threshold > 60:
        return None
    masks = [clean_mask(difference(planes[:, k], fitted) > threshold) for k in range(len(frames))]
    return link_masks(np.stack(masks), np.ones(masks[0].shape, np.float32))


def _fitted(image: Float32[np.ndarray, "3 H W"], border: Bool[np.ndarray, "H W"]) -> Float32[np.ndarray, "3 H W"]:
    """Second-order polynomial of the position through the border's colours."""
    height, width = border.shape
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    coefficients, *_ = np.linalg.lstsq(basis[border], image[:, border].T, rcond=None)
    return np.moveaxis(basis @ coefficients, -1, 0).astype(np.float32)
