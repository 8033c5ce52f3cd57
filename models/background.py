"""Silhouettes of one moving object before a background that stands still.

In the frame that differs most from the first one, the object has left one region and entered another. A line
across the direction of motion, through the middle of all that changed, separates the two (they have equal
area), so the background is known in both: the late frame shows it where the object was, the first frame
where the object came to. From these first silhouettes follow a median background and how likely each colour
is on the object; what the object covers all the time is settled by colour. Shadows darken all channels by one
factor (Horprasert et al. 1999, "A statistical approach for real-time robust background subtraction and shadow
detection") and count as background.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8

from models.appearance import (
    Picture,
    Planes,
    colour_codes,
    colour_planes,
    colour_ratio,
    difference,
    full_difference,
    noise_threshold,
    sort_pictures,
)
from models.shapes import clean_mask, link_masks
from models.stabilise import stabilise

__all__ = ["Silhouette", "background_silhouettes", "plain_background_silhouettes"]

_PLAIN_CONTRAST = 14.0  # of 255
_COLOUR_WEIGHT = 0.65  # of the log likelihood ratio, against differences in thresholds
_HOLE = -0.8  # score below which even an enclosed pixel is background


@dataclass(frozen=True)
class Silhouette:
    """Masks (0 or 255) and how far they can be trusted (0..1)."""

    mask: UInt8[np.ndarray, "T H W"]
    confidence: float


@dataclass(frozen=True)
class _Surroundings:
    """What the still pixels around each pixel look like."""

    mean: Picture
    spread: Float32[np.ndarray, "H W"]  # standard deviation


@dataclass(frozen=True)
class _Clip:
    """The part of a clip in which something moves."""

    planes: Planes
    activity: Float32[np.ndarray, "H W"]  # largest change, in thresholds
    around: _Surroundings
    threshold: Float32[np.ndarray, "H W"]  # a difference that noise does not reach


@dataclass(frozen=True)
class _Model:
    """The background, where it has been seen, and how much likelier each colour is on the object (log)."""

    background: Picture
    known: Bool[np.ndarray, "H W"]
    ratio: Float32[np.ndarray, " B"] | None


def background_silhouettes(frames: UInt8[np.ndarray, "T H W 3"]) -> Silhouette | None:
    """The moving object in RGB frames of a fixed camera; None if nothing moves or everything does."""
    steady = stabilise(frames)
    planes = colour_planes(steady.frames)
    threshold = noise_threshold(planes)
    change = np.stack([full_difference(planes[:, k], planes[:, 0]) for k in range(len(frames))])
    change /= threshold
    moved = (change > 1.0).reshape(len(frames), -1).mean(axis=1)
    far = int(moved.argmax())
    if moved[far] < 0.002 or moved[far] > 0.6:
        return None
    activity = np.minimum(change.max(axis=0), 3.0)
    around = _surroundings(planes[:, 0], activity < 0.8)
    window = _active_window(activity)
    clip = _Clip(
        planes=np.ascontiguousarray(planes[:, :, *window]),
        activity=np.ascontiguousarray(activity[window]),
        around=_Surroundings(mean=around.mean[:, *window], spread=around.spread[window]),
        threshold=np.ascontiguousarray(threshold[window]),
    )
    masks = np.zeros(frames.shape[:3], np.uint8)
    masks[:, *window] = _silhouettes(clip, np.ascontiguousarray(change[far][window]), far)
    return _judged(steady.undo(masks))


def plain_background_silhouettes(frames: UInt8[np.ndarray, "T H W 3"]) -> Silhouette | None:
    """What differs from a background that is a smooth colour field, fitted to the picture's border."""
    planes = colour_planes(frames)
    height, width = planes.shape[2:]
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    border = np.ones((height, width), bool)
    rim = max(2, min(height, width) // 16)
    border[rim:-rim, rim:-rim] = False
    image = np.median(planes[:, :: max(1, len(frames) // 5)], axis=1)
    coefficients, *_ = np.linalg.lstsq(basis[border], image[:, border].T, rcond=None)
    fitted = np.moveaxis(basis @ coefficients, -1, 0).astype(np.float32)
    residual = difference(image, fitted)
    threshold = max(_PLAIN_CONTRAST, 3.0 * float(np.quantile(residual[border], 0.8)))
    if threshold > 60:
        return None
    masks = [clean_mask((difference(planes[:, k], fitted) > threshold).astype(np.uint8)) for k in range(len(frames))]
    found = _judged(link_masks(np.stack(masks), np.ones(masks[0].shape, np.float32)))
    return None if found is None else Silhouette(mask=found.mask, confidence=0.6 * found.confidence)


def _surroundings(image: Picture, still: Bool[np.ndarray, "H W"]) -> _Surroundings:
    """Mean and spread of the still pixels around each pixel, first of all those to its left and right."""
    weight = cv2.erode(still.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.float32)
    layers = np.stack([weight, *(image * weight), *(image**2 * weight)])
    height, width = weight.shape
    total = np.zeros_like(layers)
    for size, share in (((width // 4, 3), 1.0), ((width // 2, 7), 1e-2), ((width // 2, height // 2), 1e-4)):
        total += share * np.stack([cv2.blur(layer, (size[0] | 1, size[1] | 1)) for layer in layers])
    count = np.maximum(total[0], 1e-9)
    mean = total[1:4] / count
    variance = np.maximum(total[4:] / count - mean**2, 0.0).max(axis=0)
    return _Surroundings(mean=mean, spread=np.sqrt(variance))


def _active_window(activity: Float32[np.ndarray, "H W"]) -> tuple[slice, slice]:
    """Rows and columns around everything that changes, with a margin."""
    mask = clean_mask((activity > 1.0).astype(np.uint8))
    x, y, width, height = cv2.boundingRect(mask if mask.any() else (activity > 1.0).astype(np.uint8))
    margin = 8
    rows = slice(max(0, y - margin), min(activity.shape[0], y + height + margin))
    return rows, slice(max(0, x - margin), min(activity.shape[1], x + width + margin))


def _silhouettes(
    clip: _Clip, change: Float32[np.ndarray, "H W"], far: int, *, rounds: int = 2
) -> UInt8[np.ndarray, "T H W"]:
    """Masks from a first background and `rounds` of learning from masks; `change` is that of frame `far`."""
    codes = colour_codes(clip.planes)
    model = _Model(_two_frame_background(clip, change, far), np.ones(change.shape, bool), None)
    some = slice(None, None, max(1, len(codes) // 12))  # about twelve frames are enough to learn from
    part = replace(clip, planes=clip.planes[:, some])
    for _ in range(rounds):
        masks = _segment(part, codes[some], model)
        background, known = _masked_median(part.planes, masks)
        ratio = colour_ratio(codes[some], masks)
        background = _lit(part, background, masks)
        odd = difference(background, clip.around.mean) > clip.threshold + 3.0 * clip.around.spread
        covered = ((ratio[colour_codes(background)] > 0.7) | odd) & _hull(masks)
        covered &= ~_seen_apart(part, background, masks)
        model = _Model(background, known & ~covered, ratio)
    return _segment(clip, codes, model)


def _two_frame_background(clip: _Clip, change: Float32[np.ndarray, "H W"], far: int) -> Picture:
    """Background from the first frame and the one that differs most from it.

    The line between them lies where what it leaves as background fits the surroundings best and the parts
    before and behind it have equal areas.
    """
    changed = clean_mask((change > 1.0).astype(np.uint8)) > 0
    if not changed.any():
        changed = change > 1.0
    first, last, around = clip.planes[:, 0], clip.planes[:, far], clip.around
    scale = clip.threshold + 3.0 * around.spread
    evidence = np.clip((difference(first, around.mean) - difference(last, around.mean)) / scale, -1.0, 1.0)
    y, x = np.nonzero(changed)
    across, down = _direction(clip, far)
    along = across * x + down * y
    order = np.argsort(along)
    behind = np.cumsum(evidence[y, x][order])
    score = 2.0 * behind - behind[-1] - 0.5 * np.abs(2.0 * np.arange(1, len(order) + 1) - len(order))
    middle = along[order[int(score.argmax())]]
    columns, rows = np.arange(change.shape[1])[None], np.arange(change.shape[0])[:, None]
    ahead = np.where(across * columns + down * rows > middle, 0.5, -0.5)
    seen = full_difference(first, around.mean) - full_difference(last, around.mean)
    return np.where(ahead - cv2.blur(np.clip(seen / scale, -1.0, 1.0), (5, 5)) > 0, first, last)


def _direction(clip: _Clip, far: int) -> tuple[float, float]:
    """Unit vector (x, y down) of the motion of what is active until frame `far`; down if it rests."""
    centres = []
    for k in range(far):
        active = difference(clip.planes[:, k + 1], clip.planes[:, k], both=True) > clip.threshold
        if active.sum() > 8:
            y, x = np.nonzero(active)
            centres.append((x.mean(), y.mean()))
    if len(centres) < 2:
        return 0.0, 1.0
    path = np.array(centres)
    step = path[-2:].mean(axis=0) - path[:2].mean(axis=0)
    length = float(np.hypot(*step))
    return (0.0, 1.0) if length < 1.0 else (float(step[0] / length), float(step[1] / length))


def _segment(clip: _Clip, codes: Int32[np.ndarray, "T H W"], model: _Model) -> UInt8[np.ndarray, "T H W"]:
    edges = np.abs(cv2.Sobel(model.background[0], cv2.CV_32F, 1, 0))
    edges += np.abs(cv2.Sobel(model.background[0], cv2.CV_32F, 0, 1))
    surely = clip.threshold + 0.04 * edges
    roughly = clip.threshold + 2.5 * clip.around.spread
    expected = np.where(model.known, model.background, clip.around.mean)
    scale = 1.0 / np.where(model.known, surely, roughly)
    lowest = np.where(model.known, np.float32(-1.5), np.float32(-0.7))
    masks = np.empty(codes.shape, np.uint8)
    for k, code in enumerate(codes):
        distance = difference(clip.planes[:, k], expected)
        score = np.clip(distance * scale - 1.0, lowest, 2.0)
        if model.ratio is not None:
            score += _COLOUR_WEIGHT * model.ratio[code]
        smooth = cv2.blur(score, (3, 3))
        mask = clean_mask((smooth > 0).astype(np.uint8))
        hole = cv2.morphologyEx((smooth < _HOLE).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        mask = np.where(hole > 0, np.uint8(0), mask)
        masks[k] = _half_covered(mask, distance)
    return link_masks(masks, clip.activity)


def _half_covered(mask: UInt8[np.ndarray, "H W"], distance: Float32[np.ndarray, "H W"]) -> UInt8[np.ndarray, "H W"]:
    """Take from the mask's rim the pixels that stand out less than half as much as those further in."""
    inside = cv2.erode(mask, np.ones((3, 3), np.uint8))
    strength = cv2.dilate(np.where(mask > 0, distance, np.float32(0)), np.ones((5, 5), np.uint8))
    faint = (inside == 0) & (distance < 0.45 * strength)
    return np.where(faint, np.uint8(0), mask)


def _seen_apart(clip: _Clip, background: Picture, masks: UInt8[np.ndarray, "T H W"]) -> Bool[np.ndarray, "H W"]:
    """Where the background is seen twice with something else in between, or well away from the object."""
    seen, other, again = (np.zeros(background.shape[1:], bool) for _ in range(3))
    away = np.zeros(background.shape[1:], np.uint8)
    reach = 1 + 2 * round(0.4 * float(np.sqrt(np.median((masks > 0).sum(axis=(1, 2))))))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    for image, mask in zip(np.moveaxis(clip.planes, 1, 0), masks, strict=True):
        distance = difference(image, background) / clip.threshold
        again |= other & (distance < 0.7)
        other |= seen & (distance > 1.5)
        seen |= distance < 0.7
        away += (distance < 0.7) & (cv2.dilate(mask, kernel) == 0)
    return again | (away >= 2)


def _lit(clip: _Clip, background: Picture, masks: UInt8[np.ndarray, "T H W"]) -> Picture:
    """The background without the shadow that lay on it when it was seen most often."""
    total, count = np.zeros_like(background), np.zeros(background.shape[1:], np.float32)
    for image, mask in zip(np.moveaxis(clip.planes, 1, 0), masks, strict=True):
        factor = (background[0] + 2.0) / (image[0] + 2.0)
        tint = np.maximum(np.abs(background[1] - factor * image[1]), np.abs(background[2] - factor * image[2]))
        brighter = (
            (factor < 0.9)
            & (factor > 0.2)
            & (tint < clip.threshold)
            & (cv2.dilate(mask, np.ones((5, 5), np.uint8)) == 0)
        )
        total += image * brighter
        count += brighter
    return np.where(count >= 2, total / np.maximum(count, 1.0), background)


def _masked_median(planes: Planes, masks: UInt8[np.ndarray, "T H W"]) -> tuple[Picture, Bool[np.ndarray, "H W"]]:
    """Median over the frames in which a pixel is not covered, and where there are at least two."""
    kernel = np.ones((5, 5), np.uint8)
    free = np.stack([cv2.dilate(mask, kernel) for mask in masks]) == 0
    count = free.sum(axis=0)
    far_away = np.float32(1e4)
    ordered = sort_pictures([np.where(f, planes[:, k], far_away) for k, f in enumerate(free)])
    middle = np.maximum(count - 1, 0) // 2
    median = np.take_along_axis(ordered, middle[None, None], axis=0)[0]
    return np.where(median < far_away, median, planes[:, 0]), count >= 2


def _hull(masks: UInt8[np.ndarray, "T H W"]) -> Bool[np.ndarray, "H W"]:
    union = masks.max(axis=0)
    points = cv2.findNonZero(union)
    hull = np.zeros_like(union)
    if points is not None:
        cv2.fillConvexPoly(hull, cv2.convexHull(points), 1)
    return hull > 0


def _judged(masks: UInt8[np.ndarray, "T H W"]) -> Silhouette | None:
    """Confidence from how steady the area is; None if it is no object's size."""
    areas = (masks > 0).reshape(len(masks), -1).mean(axis=1)
    typical = float(np.median(areas))
    if typical < 0.001 or typical > 0.7:
        return None
    steady = float(np.mean(np.abs(areas / typical - 1) < 0.35))
    return Silhouette(mask=masks, confidence=steady)
