"""Silhouettes of one moving object before a background that stands still.

The idea: in the frame that differs most from the first one, the object has left one region and entered
another. A line across the direction of motion, through the middle of all that changed, separates the two
(they have equal area), so the background is known in both: the late frame shows it where the object was,
the first frame where the object came to. What the object covers all the time is settled by colour.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

__all__ = ["Silhouette", "background_silhouettes", "plain_background_silhouettes"]

_CHANNEL_WEIGHT = np.array([0.8, 1.6, 1.6], dtype=np.float32)  # Lab: chroma says more than lightness
_LEAST_CONTRAST = 9.0  # in weighted Lab steps of 1/255
_BINS = 12  # per colour channel


@dataclass(frozen=True)
class Silhouette:
    """Masks (0 or 255) and how far they can be trusted (0..1)."""

    mask: UInt8[np.ndarray, "T H W"]
    confidence: float


def background_silhouettes(frames: UInt8[np.ndarray, "T H W 3"], *, rounds: int = 2) -> Silhouette | None:
    """The moving object in RGB frames of a fixed camera; None if nothing moves or everything does."""
    lab = _lab(frames)
    threshold = max(_LEAST_CONTRAST, 4.5 * _noise(lab))
    change = np.stack([_distance(image, lab[0]) for image in lab])
    moved = (change > threshold).reshape(len(lab), -1).mean(axis=1)
    far = int(moved.argmax())
    if moved[far] < 0.002 or moved[far] > 0.6:
        return None
    background, known = _two_frame_background(lab, change, far, threshold)
    masks = _segment(lab, background, known, None, threshold)
    for _ in range(rounds):
        background, known = _masked_median(lab, masks)
        ratio = _colour_ratio(lab, masks)
        known &= ~((ratio[_codes(background)] > 1.0) & _hull(masks))
        masks = _segment(lab, background, known, ratio, threshold)
    return _judged(masks)


def plain_background_silhouettes(frames: UInt8[np.ndarray, "T H W 3"]) -> Silhouette | None:
    """What differs from a background that is a smooth colour field, fitted to the picture's border."""
    lab = _lab(frames)
    height, width = lab.shape[1:3]
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6)
    border = np.ones((height, width), bool)
    rim = max(2, min(height, width) // 16)
    border[rim:-rim, rim:-rim] = False
    image = np.median(lab[:: max(1, len(lab) // 5)], axis=0).reshape(-1, 3)
    inside = border.ravel()
    coefficients, *_ = np.linalg.lstsq(basis[inside], image[inside], rcond=None)
    fitted = (basis @ coefficients).reshape(height, width, 3).astype(np.float32)
    residual = _distance(image.reshape(height, width, 3).astype(np.float32), fitted)
    threshold = max(2 * _LEAST_CONTRAST, 4.0 * float(np.quantile(residual[border], 0.8)))
    if threshold > 60:
        return None
    masks = np.stack([_clean((_distance(frame, fitted) > threshold).astype(np.uint8)) for frame in lab])
    found = _judged(_linked(masks))
    return None if found is None else Silhouette(mask=found.mask, confidence=0.6 * found.confidence)


def _lab(frames: UInt8[np.ndarray, "T H W 3"]) -> Float32[np.ndarray, "T H W 3"]:
    """Lab of frames brought to the first one's exposure, slightly blurred against noise."""
    thin = frames[:, ::4, ::4].astype(np.float32) + 1.0
    gains = np.median((thin[0] / thin).reshape(len(frames), -1), axis=1)
    out = np.empty(frames.shape, np.float32)
    for k, (frame, gain) in enumerate(zip(frames, gains, strict=True)):
        image = frame if abs(gain - 1) < 0.004 else cv2.convertScaleAbs(frame, alpha=float(gain))
        out[k] = cv2.cvtColor(cv2.GaussianBlur(image, (3, 3), 0.7), cv2.COLOR_RGB2Lab)
    return out


def _noise(lab: Float32[np.ndarray, "T H W 3"]) -> float:
    """Standard deviation of what a still pixel does, in weighted Lab steps."""
    steps = np.abs(np.diff(lab[:, ::3, ::3], axis=0)) * _CHANNEL_WEIGHT
    return float(np.median(steps.max(axis=-1)))


def _distance(
    image: Float32[np.ndarray, "H W 3"], other: Float32[np.ndarray, "H W 3"]
) -> Float32[np.ndarray, "H W"]:
    """Weighted Lab distance in which an even darkening of the same colour, a shadow's mark, counts little."""
    delta = image - other
    chroma = np.maximum(np.abs(delta[..., 1]), np.abs(delta[..., 2])) * _CHANNEL_WEIGHT[1]
    light = np.abs(delta[..., 0]) * _CHANNEL_WEIGHT[0]
    return np.maximum(chroma, light)


def _two_frame_background(
    lab: Float32[np.ndarray, "T H W 3"], change: Float32[np.ndarray, "T H W"], far: int, threshold: float
) -> tuple[Float32[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"]]:
    """Background from the first frame and the one that differs most from it."""
    changed = _clean((change[far] > threshold).astype(np.uint8)) > 0
    if not changed.any():
        changed = change[far] > threshold
    y, x = np.nonzero(changed)
    direction = _direction(lab, far, threshold)
    along = (np.arange(lab.shape[2])[None] - x.mean()) * direction[0]
    along = along + (np.arange(lab.shape[1])[:, None] - y.mean()) * direction[1]
    background = np.where((along > 0)[..., None], lab[0], lab[far])
    return background, np.ones(changed.shape, bool)


def _direction(lab: Float32[np.ndarray, "T H W 3"], far: int, threshold: float) -> tuple[float, float]:
    """Unit vector (x, y down) of the motion of what is active until frame `far`; down if it rests."""
    centres = []
    for k in range(far):
        active = _distance(lab[k + 1], lab[k]) > threshold
        if active.sum() > 8:
            y, x = np.nonzero(active)
            centres.append((x.mean(), y.mean()))
    if len(centres) < 2:
        return 0.0, 1.0
    path = np.array(centres)
    step = path[-2:].mean(axis=0) - path[:2].mean(axis=0)
    length = float(np.hypot(*step))
    return (0.0, 1.0) if length < 1.0 else (float(step[0] / length), float(step[1] / length))


def _segment(
    lab: Float32[np.ndarray, "T H W 3"],
    background: Float32[np.ndarray, "H W 3"],
    known: Bool[np.ndarray, "H W"],
    ratio: Float32[np.ndarray, " B"] | None,
    threshold: float,
) -> UInt8[np.ndarray, "T H W"]:
    masks = np.empty(lab.shape[:3], np.uint8)
    for k, image in enumerate(lab):
        score = np.clip(_distance(image, background) / threshold - 1.0, -1.5, 2.0) * known
        if ratio is not None:
            score += 0.4 * ratio[_codes(image)]
        masks[k] = _clean((cv2.blur(score.astype(np.float32), (3, 3)) > 0).astype(np.uint8))
    return _linked(masks)


def _codes(image: Float32[np.ndarray, "*S 3"]) -> np.ndarray:
    """Number of the colour bin of each pixel."""
    bins = np.clip(image * (_BINS / 256.0), 0, _BINS - 1).astype(np.int32)
    return (bins[..., 0] * _BINS + bins[..., 1]) * _BINS + bins[..., 2]


def _colour_ratio(
    lab: Float32[np.ndarray, "T H W 3"], masks: UInt8[np.ndarray, "T H W"]
) -> Float32[np.ndarray, " B"]:
    """log of how much likelier each colour is on the object than off it, clipped to +-2.5."""
    codes, inside = _codes(lab), masks > 0
    counts = [np.bincount(codes[part], minlength=_BINS**3).astype(np.float32) for part in (inside, ~inside)]
    shares = [_smooth(count) / max(float(count.sum()), 1.0) + 1e-4 for count in counts]
    return np.clip(np.log(shares[0] / shares[1]), -2.5, 2.5).astype(np.float32)


def _smooth(counts: Float32[np.ndarray, " B"]) -> Float32[np.ndarray, " B"]:
    cube = counts.reshape(_BINS, _BINS, _BINS)
    for axis in range(3):
        padded = np.pad(cube, [(1, 1) if a == axis else (0, 0) for a in range(3)])
        cube = (
            0.25 * np.take(padded, range(_BINS), axis)
            + 0.5 * cube
            + 0.25 * np.take(padded, range(2, _BINS + 2), axis)
        )
    return cube.ravel()


def _masked_median(
    lab: Float32[np.ndarray, "T H W 3"], masks: UInt8[np.ndarray, "T H W"]
) -> tuple[Float32[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"]]:
    """Median over the frames in which a pixel is not covered, and where there are at least two."""
    kernel = np.ones((5, 5), np.uint8)
    free = np.stack([cv2.dilate(mask, kernel) for mask in masks]) == 0
    count = free.sum(axis=0)
    ordered = np.sort(np.where(free[..., None], lab, np.float32(1e3)), axis=0)
    middle = np.maximum(count - 1, 0) // 2
    median = np.take_along_axis(ordered, middle[None, ..., None], axis=0)[0]
    return np.minimum(median, 255.0), count >= 2


def _hull(masks: UInt8[np.ndarray, "T H W"]) -> Bool[np.ndarray, "H W"]:
    union = masks.max(axis=0)
    points = cv2.findNonZero(union)
    hull = np.zeros_like(union)
    if points is not None:
        cv2.fillConvexPoly(hull, cv2.convexHull(points), 1)
    return hull > 0


def _clean(mask: UInt8[np.ndarray, "H W"]) -> UInt8[np.ndarray, "H W"]:
    """Open, close and fill holes; 0 or 255."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, cross)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    return cv2.drawContours(np.zeros_like(mask), outlines, -1, 255, cv2.FILLED)


def _linked(masks: UInt8[np.ndarray, "T H W"]) -> UInt8[np.ndarray, "T H W"]:
    """Keep in each frame the component that continues its neighbour's, outward from the largest."""
    parts = [cv2.connectedComponentsWithStats(mask, connectivity=8) for mask in masks]
    largest = [int(stats[1:, cv2.CC_STAT_AREA].max()) if n > 1 else 0 for n, _, stats, _ in parts]
    start = int(np.argmax(largest))
    out = np.zeros_like(masks)
    for order in (range(start, len(masks)), range(start - 1, -1, -1)):
        previous = out[start] if order.step < 0 else None
        for k in order:
            count, labels, stats, _ = parts[k]
            if count < 2:
                continue
            weight = stats[1:, cv2.CC_STAT_AREA].astype(np.float64)
            if previous is not None:
                near = cv2.dilate(previous, np.ones((9, 9), np.uint8)) > 0
                weight = np.bincount(labels[near], minlength=count)[1:] + 0.2 * weight
            out[k] = (labels == 1 + int(weight.argmax())) * np.uint8(255)
            previous = out[k]
    return out


def _judged(masks: UInt8[np.ndarray, "T H W"]) -> Silhouette | None:
    """Confidence from how steady the area is and whether it is an object's size."""
    areas = (masks > 0).reshape(len(masks), -1).mean(axis=1)
    typical = float(np.median(areas))
    if typical < 0.001 or typical > 0.7:
        return None
    steady = float(np.mean(np.abs(areas / typical - 1) < 0.35))
    return Silhouette(mask=masks, confidence=steady)
