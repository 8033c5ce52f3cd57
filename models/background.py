"""Silhouettes of one moving object before a background that stands still.

In the frame that differs most from the first one, the object has left one region and entered another. A line
across the direction of motion, through the middle of all that changed, separates the two (they have equal
area), so the background is known in both: the late frame shows it where the object was, the first frame
where the object came to. From these first silhouettes follow a median background and how likely each colour
is on the object; what the object covers all the time is settled by colour. Shadows darken all channels by one
factor (Horprasert et al. 1999, "A statistical approach for real-time robust background subtraction and shadow
detection") and count as background.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8

from models.shapes import clean_mask, link_masks
from models.stabilise import Stabilised, stabilise

__all__ = ["Silhouette", "background_silhouettes", "plain_background_silhouettes"]

Planes = Float32[np.ndarray, "3 T H W"]  # brightness and two colour differences, 0..255
Picture = Float32[np.ndarray, "3 H W"]

_LEAST_CONTRAST = 7.0  # of 255
_SHADOW = (0.35, 0.96)  # a shadow's factor on the brightness
_BINS = (12, 16, 16)  # of brightness and colour differences


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
class _Model:
    """The background where it has been seen, its surroundings where not."""

    background: Picture
    known: Bool[np.ndarray, "H W"]
    around: _Surroundings
    threshold: Float32[np.ndarray, "H W"]


def background_silhouettes(frames: UInt8[np.ndarray, "T H W 3"], *, rounds: int = 2) -> Silhouette | None:
    """The moving object in RGB frames of a fixed camera; None if nothing moves or everything does."""
    steady = stabilise(frames)
    planes = _planes(steady.frames)
    threshold = _threshold(planes)
    change = np.stack([_difference(planes[:, k], planes[:, 0], both=True) for k in range(len(frames))])
    change /= threshold
    moved = (change > 1.0).reshape(len(frames), -1).mean(axis=1)
    far = int(moved.argmax())
    if moved[far] < 0.002 or moved[far] > 0.6:
        return None
    activity = np.minimum(change.max(axis=0), 3.0)
    around = _surroundings(planes[:, 0], activity < 0.8)
    background = _two_frame_background(planes, change, far, around, threshold)
    known = np.ones(background.shape[1:], bool)
    ratio: np.ndarray | None = None
    codes = _codes(planes)
    for _ in range(rounds):
        model = _Model(background, known, around, threshold)
        masks = _segment(planes, codes, model, ratio, activity)
        background, known = _masked_median(planes, masks)
        ratio = _colour_ratio(codes, masks)
        odd = _difference(background, around.mean) > threshold + 3.0 * around.spread
        known &= ~(((ratio[_codes(background)] > 0.7) | odd) & _hull(masks))
    masks = _segment(planes, codes, _Model(background, known, around, threshold), ratio, activity)
    return _judged(steady.undo(masks))


def plain_background_silhouettes(frames: UInt8[np.ndarray, "T H W 3"]) -> Silhouette | None:
    """What differs from a background that is a smooth colour field, fitted to the picture's border."""
    planes = _planes(frames)
    height, width = planes.shape[2:]
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    border = np.ones((height, width), bool)
    rim = max(2, min(height, width) // 16)
    border[rim:-rim, rim:-rim] = False
    image = np.median(planes[:, :: max(1, len(frames) // 5)], axis=1)
    coefficients, *_ = np.linalg.lstsq(basis[border], image[:, border].T, rcond=None)
    fitted = np.moveaxis(basis @ coefficients, -1, 0).astype(np.float32)
    residual = _difference(image, fitted)
    threshold = max(2 * _LEAST_CONTRAST, 3.0 * float(np.quantile(residual[border], 0.8)))
    if threshold > 60:
        return None
    masks = [
        clean_mask((_difference(planes[:, k], fitted) > threshold).astype(np.uint8))
        for k in range(len(frames))
    ]
    found = _judged(link_masks(np.stack(masks), np.ones(masks[0].shape, np.float32)))
    return None if found is None else Silhouette(mask=found.mask, confidence=0.6 * found.confidence)


def _planes(frames: UInt8[np.ndarray, "T H W 3"]) -> Planes:
    """Brightness and colour differences (linear in RGB, so that a shadow scales all), blurred against noise."""
    matrix = np.array([[1 / 3, 1 / 3, 1 / 3], [1, -1, 0], [0.5, 0.5, -1]], dtype=np.float32)
    out = np.empty((3, *frames.shape[:3]), np.float32)
    for k, frame in enumerate(frames):
        image = cv2.GaussianBlur(frame, (3, 3), 0.7).astype(np.float32)
        out[:, k] = np.moveaxis(cv2.transform(image, matrix), -1, 0)
    return out


def _difference(image: Picture, background: Picture, *, both: bool = False) -> Float32[np.ndarray, "H W"]:
    """How far a picture is from the background; a shadow on the background counts little.

    With `both`, the background may be the one in shadow.
    """
    light = cv2.absdiff(image[0], background[0])
    colour = np.maximum(cv2.absdiff(image[1], background[1]), cv2.absdiff(image[2], background[2]))
    full = np.maximum(light, colour)
    factor = (image[0] + 2.0) / (background[0] + 2.0)
    tint = np.maximum(np.abs(image[1] - factor * background[1]), np.abs(image[2] - factor * background[2]))
    shadow = (factor > _SHADOW[0]) & (factor < _SHADOW[1])
    smooth = np.abs(factor - cv2.blur(factor, (5, 5))) < 0.08
    if both:
        shadow |= (factor > 1 / _SHADOW[1]) & (factor < 1 / _SHADOW[0])
    return np.where(shadow & smooth, np.minimum(full, 1.5 * tint), full)


def _threshold(planes: Planes) -> Float32[np.ndarray, "H W"]:
    """Difference that noise alone does not reach: at least 4.5 times what the pixel does between frames."""
    steps = [np.abs(planes[:, k + 1] - planes[:, k]).max(axis=0) for k in range(planes.shape[1] - 1)]
    local = cv2.blur(_sorted(steps)[len(steps) // 2], (3, 3))
    return np.clip(np.maximum(4.5 * float(np.median(local)), 3.5 * local), _LEAST_CONTRAST, 40.0)


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


def _two_frame_background(
    planes: Planes,
    change: Float32[np.ndarray, "T H W"],
    far: int,
    around: _Surroundings,
    threshold: Float32[np.ndarray, "H W"],
) -> Picture:
    """Background from the first frame and the one that differs most from it.

    The line between them lies where what it leaves as background fits the surroundings best and the parts
    before and behind it have equal areas.
    """
    changed = clean_mask((change[far] > 1.0).astype(np.uint8)) > 0
    if not changed.any():
        changed = change[far] > 1.0
    first, last = planes[:, 0], planes[:, far]
    scale = threshold + 2.0 * around.spread
    evidence = np.clip((_difference(first, around.mean) - _difference(last, around.mean)) / scale, -1.0, 1.0)
    y, x = np.nonzero(changed)
    across, down = _direction(planes, far, threshold)
    along = across * x + down * y
    order = np.argsort(along)
    behind = np.cumsum(evidence[y, x][order])
    score = 2.0 * behind - behind[-1] - 0.5 * np.abs(2.0 * np.arange(1, len(order) + 1) - len(order))
    middle = along[order[int(score.argmax())]]
    columns, rows = np.arange(planes.shape[3])[None], np.arange(planes.shape[2])[:, None]
    ahead = np.where(across * columns + down * rows > middle, 0.5, -0.5)
    return np.where(ahead - cv2.blur(evidence, (5, 5)) > 0, first, last)


def _direction(planes: Planes, far: int, threshold: Float32[np.ndarray, "H W"]) -> tuple[float, float]:
    """Unit vector (x, y down) of the motion of what is active until frame `far`; down if it rests."""
    centres = []
    for k in range(far):
        active = _difference(planes[:, k + 1], planes[:, k], both=True) > threshold
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
    planes: Planes,
    codes: Int32[np.ndarray, "T H W"],
    model: _Model,
    ratio: Float32[np.ndarray, " B"] | None,
    activity: Float32[np.ndarray, "H W"],
) -> UInt8[np.ndarray, "T H W"]:
    edges = np.abs(cv2.Sobel(model.background[0], cv2.CV_32F, 1, 0))
    edges += np.abs(cv2.Sobel(model.background[0], cv2.CV_32F, 0, 1))
    surely = model.threshold + 0.04 * edges
    roughly = model.threshold + 2.5 * model.around.spread
    expected = np.where(model.known, model.background, model.around.mean)
    scale = 1.0 / np.where(model.known, surely, roughly)
    lowest = np.where(model.known, -1.5, -0.7)
    masks = np.empty(planes.shape[1:], np.uint8)
    for k in range(planes.shape[1]):
        score = np.clip(_difference(planes[:, k], expected) * scale - 1.0, lowest, 2.0)
        if ratio is not None:
            score += 0.4 * ratio[codes[k]]
        masks[k] = clean_mask((cv2.blur(score.astype(np.float32), (3, 3)) > 0).astype(np.uint8))
    return link_masks(masks, activity)


def _codes(planes: Float32[np.ndarray, "3 *S"]) -> Int32[np.ndarray, "*S"]:
    """Number of the colour bin of each pixel; colour differences beyond +-128 share the last bin."""
    first = np.clip(planes[0] * (_BINS[0] / 256), 0, _BINS[0] - 1).astype(np.int32)
    second = np.clip((planes[1] + 128) * (_BINS[1] / 256), 0, _BINS[1] - 1).astype(np.int32)
    third = np.clip((planes[2] + 128) * (_BINS[2] / 256), 0, _BINS[2] - 1).astype(np.int32)
    return (first * _BINS[1] + second) * _BINS[2] + third


def _colour_ratio(
    codes: Int32[np.ndarray, "T H W"], masks: UInt8[np.ndarray, "T H W"]
) -> Float32[np.ndarray, " B"]:
    """log of how much likelier each colour is on the object than around it, clipped to +-2.5."""
    near = cv2.dilate(masks.max(axis=0), np.ones((25, 25), np.uint8)) > 0
    inside = masks > 0
    counts = [np.bincount(codes[part], minlength=int(np.prod(_BINS))) for part in (inside, ~inside & near)]
    shares = [_smooth(count.astype(np.float32)) / max(float(count.sum()), 1.0) + 2e-4 for count in counts]
    return np.clip(np.log(shares[0] / shares[1]), -2.5, 2.5).astype(np.float32)


def _smooth(counts: Float32[np.ndarray, " B"]) -> Float32[np.ndarray, " B"]:
    cube = np.pad(counts.reshape(_BINS), 1)
    for axis in range(3):
        cube = 0.25 * np.roll(cube, 1, axis) + 0.5 * cube + 0.25 * np.roll(cube, -1, axis)
    return cube[1:-1, 1:-1, 1:-1].ravel()


def _masked_median(
    planes: Planes, masks: UInt8[np.ndarray, "T H W"]
) -> tuple[Picture, Bool[np.ndarray, "H W"]]:
    """Median over the frames in which a pixel is not covered, and where there are at least two."""
    kernel = np.ones((5, 5), np.uint8)
    free = np.stack([cv2.dilate(mask, kernel) for mask in masks]) == 0
    count = free.sum(axis=0)
    far_away = np.float32(1e4)
    ordered = _sorted([np.where(f, planes[:, k], far_away) for k, f in enumerate(free)])
    middle = np.maximum(count - 1, 0) // 2
    median = np.take_along_axis(ordered, middle[None, None], axis=0)[0]
    return np.where(median < far_away, median, planes[:, 0]), count >= 2


def _sorted(pictures: list[np.ndarray]) -> Float32[np.ndarray, "T 3 H W"]:
    """Sort each pixel over the pictures: Batcher's merge exchange sort (Knuth, TAOCP 3, 5.2.2 M), pixels in parallel."""
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
