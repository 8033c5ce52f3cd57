"""The object's outline, sharpened by the background as it is seen where the object is not, and by its colours.

The background is the median over the frames in which the network says that the object is elsewhere. How far a
pixel is from it, and how much likelier its colour is on the object than around it, is added to the network's log odds.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from models.activity import noise_level
from models.appearance import Picture, Planes, colour_codes, colour_planes, colour_ratio, difference, sort_pictures

__all__ = ["refined_coverage", "uncovered_background"]

_SCORE_RANGE = (-1.5, 2.0)  # of a pixel's distance from the background, in thresholds above the first
_COLOUR_WEIGHT = 0.65  # of the log likelihood ratio of the colour
_PRIOR_WEIGHT = 0.6  # of the network's log odds
_SHARPNESS = 1.6  # of the log odds, so that the overlap they promise is about the one measured
_EDGE_SHARE = 0.04  # of the background's gradient that misplaced pixels may differ by
_HALF = 0.45  # of the distance further in: below it a pixel at the rim is mostly background


def refined_coverage(
    frames: UInt8[np.ndarray, "T H W 3"], coverage: Float32[np.ndarray, "T H W"], *, rounds: int = 2
) -> Float32[np.ndarray, "T H W"]:
    """Coverage (0..1) from the network's and from what the frames show of background and object."""
    planes = colour_planes(frames)
    codes, noise = colour_codes(planes), noise_level(frames)
    prior = _PRIOR_WEIGHT * (np.log(coverage + 1e-3) - np.log(1.001 - coverage))
    out = coverage
    for _ in range(rounds):
        masks = ((out > 0.5) * np.uint8(255)).astype(np.uint8)
        background, known = uncovered_background(planes, masks)
        ratio = _COLOUR_WEIGHT * colour_ratio(codes, masks)
        scale = known / (noise + _EDGE_SHARE * _gradient(background[0]))
        out = np.empty_like(coverage)
        for k, code in enumerate(codes):
            distance = difference(planes[:, k], background)
            score = np.clip(distance * scale - known, *_SCORE_RANGE) + ratio[code]
            odds = cv2.blur(score.astype(np.float32), (3, 3)) + prior[k]
            out[k] = _half_covered(1 / (1 + np.exp(-_SHARPNESS * odds)), distance)
    return out


def uncovered_background(planes: Planes, masks: UInt8[np.ndarray, "T H W"]) -> tuple[Picture, Bool[np.ndarray, "H W"]]:
    """Median over the frames in which a pixel is not near the object, and where there are at least two."""
    kernel = np.ones((5, 5), np.uint8)
    free = np.stack([cv2.dilate(mask, kernel) for mask in masks]) == 0
    count = free.sum(axis=0)
    far_away = np.float32(1e4)
    ordered = sort_pictures([np.where(f, planes[:, k], far_away) for k, f in enumerate(free)])
    middle = np.maximum(count - 1, 0) // 2
    median = np.take_along_axis(ordered, middle[None, None], axis=0)[0]
    return np.where(median < far_away, median, planes[:, 0]), count >= 2


def _gradient(image: Float32[np.ndarray, "H W"]) -> Float32[np.ndarray, "H W"]:
    return np.abs(cv2.Sobel(image, cv2.CV_32F, 1, 0)) + np.abs(cv2.Sobel(image, cv2.CV_32F, 0, 1))


def _half_covered(
    coverage: Float32[np.ndarray, "H W"], distance: Float32[np.ndarray, "H W"]
) -> Float32[np.ndarray, "H W"]:
    """Empty the pixels at the rim that stand out less than half as much as those further in."""
    mask = (coverage > 0.5).astype(np.uint8)
    inside = cv2.erode(mask, np.ones((3, 3), np.uint8))
    strength = cv2.dilate(np.where(mask > 0, distance, np.float32(0)), np.ones((5, 5), np.uint8))
    faint = (mask > 0) & (inside == 0) & (distance < _HALF * strength)
    return np.where(faint, np.minimum(coverage, np.float32(0.3)), coverage)
