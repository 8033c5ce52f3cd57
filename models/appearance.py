"""Colours of a clip for the background model: planes, differences, histograms."""

from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Shaped, UInt8, UInt16

Planes: TypeAlias = Float32[np.ndarray, "3 T H W"]  # brightness and two colour differences, of 255
Picture: TypeAlias = Float32[np.ndarray, "3 H W"]

_SHADOW = (0.2, 0.96)  # a shadow's factor on the brightness
_LEVELS = 16  # of each colour, in histograms
LARGEST_RATIO = 2.5  # of logarithms of likelihoods


def colour_planes(frames: UInt8[np.ndarray, "T H W 3"]) -> Planes:
    """Brightness and colour differences (linear in RGB: a shadow scales all), blurred against noise."""
    matrix = np.array([[1 / 3, 1 / 3, 1 / 3], [1, -1, 0], [0.5, 0.5, -1]], dtype=np.float32)
    out = np.empty((3, *frames.shape[:3]), np.float32)
    for k, frame in enumerate(frames):
        image = cv2.GaussianBlur(frame, (3, 3), 0.7).astype(np.float32)
        out[:, k] = np.moveaxis(cv2.transform(image, matrix), -1, 0)
    return out


def _full_difference(image: Picture, background: Picture) -> Float32[np.ndarray, "H W"]:
    """Largest difference of brightness and colours."""
    light = cv2.absdiff(image[0], background[0])
    return np.maximum(light, np.maximum(cv2.absdiff(image[1], background[1]), cv2.absdiff(image[2], background[2])))


def difference(image: Picture, background: Picture) -> Float32[np.ndarray, "H W"]:
    """Distance of a picture from the background; a shadow on the background counts little."""
    full = _full_difference(image, background)
    factor = (image[0] + 2.0) / (background[0] + 2.0)
    tint = np.maximum(np.abs(image[1] - factor * background[1]), np.abs(image[2] - factor * background[2]))
    shadow = (factor > _SHADOW[0]) & (factor < _SHADOW[1])
    smooth = np.abs(factor - cv2.blur(factor, (5, 5))) < 0.1
    return np.where(shadow & smooth, np.minimum(full, 1.5 * tint), full)


def colour_codes(frames: UInt8[np.ndarray, "*S 3"]) -> UInt16[np.ndarray, "*S"]:
    """Number of the colour bin of each pixel: 16 levels of red, green and blue."""
    level = (frames >> 4).astype(np.uint16)
    return (level[..., 0] << 8) | (level[..., 1] << 4) | level[..., 2]


def colour_ratio(codes: UInt16[np.ndarray, "T H W"], inside: Bool[np.ndarray, "T H W"]) -> Float32[np.ndarray, " B"]:
    """Log-likelihood ratio of each colour, object over surroundings, clipped to +-2.5."""
    seen = np.asarray(inside.any(axis=0), np.uint8)
    near = cv2.dilate(seen, np.ones((25, 25), np.uint8)) > 0
    counts = [np.bincount(codes[part], minlength=_LEVELS**3) for part in (inside, ~inside & near)]
    shares = [_smooth(count.astype(np.float32)) / max(float(count.sum()), 1.0) + 2e-4 for count in counts]
    return np.clip(np.log(shares[0] / shares[1]), -LARGEST_RATIO, LARGEST_RATIO).astype(np.float32)


def _smooth(counts: Float32[np.ndarray, " B"]) -> Float32[np.ndarray, " B"]:
    cube = np.pad(counts.reshape(_LEVELS, _LEVELS, _LEVELS), 1)
    for axis in range(3):
        cube = 0.25 * np.roll(cube, 1, axis) + 0.5 * cube + 0.25 * np.roll(cube, -1, axis)
    return cube[1:-1, 1:-1, 1:-1].ravel()


def sort_pictures(pictures: list[np.ndarray]) -> Shaped[np.ndarray, "T *S"]:
    """Sort over the pictures, all pixels at once (Batcher's merge exchange; Knuth, TAOCP 3, 5.2.2)."""
    count, p = len(pictures), 1
    while p < count:
        k = p
        while k >= 1:
            for j in range(k % p, count - k, 2 * k):
                for i in range(j, min(j + k, count - k)):
                    if i // (2 * p) == (i + k) // (2 * p):
                        low, high = pictures[i], pictures[i + k]
                        pictures[i], pictures[i + k] = np.minimum(low, high), np.maximum(low, high)
            k //= 2
        p *= 2
    return np.stack(pictures)
