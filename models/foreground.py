"""The object's silhouette in each frame: from opacity, a given mask, or a background model."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from models.appearance import colour_planes, difference, sort_pictures
from models.downscaling import shrink
from models.stabilisation import stabilise
from physconvex import InputError

ForegroundSource = Literal["alpha", "mask", "background_model", "whole_frame"]
Window = tuple[slice, slice]  # rows and columns

_WORKING_SIDE = 128  # [px]
_LEAST_CONFIDENCE = 0.2  # below it the whole frame is used
_PLAIN_CONFIDENCE = 0.6  # a difference from a plain background may be something else
_OBJECT_SHARE = (0.001, 0.7)  # of the picture that an object may cover
_LEAST_CONTRAST = 7.0  # of 255
_PLAIN_CONTRAST = 14.0  # of 255
_LEAST_MOVED, _MOST_MOVED = 0.002, 0.6  # share of the picture that a moving object may change
_MARGIN = 8  # [px]


@dataclass(frozen=True)
class Foreground:
    """Silhouette of the object in each frame, its source and its confidence (0..1)."""

    mask: Bool[np.ndarray, "T H W"]
    source: ForegroundSource
    confidence: float


@dataclass(frozen=True)
class _Silhouette:
    """Coverage (0..255) and how far it can be trusted (0..1)."""

    coverage: UInt8[np.ndarray, "T H W"]
    confidence: float


def locate_foreground(
    frames: UInt8[np.ndarray, "T H W 3"],
    *,
    alpha: np.ndarray | None = None,
    mask: np.ndarray | None = None,
) -> Foreground:
    """Silhouette of the one object in a clip of a fixed camera.

    A given `mask` [T, H, W] (bool, or 8 bits and above 127) is taken, else `alpha`, else what moves before a
    static background (`models.segmenter`, `models.outline`), else what differs from a plain one, else the
    whole frame with confidence 0.

    Raises:
        InputError: `mask` or `alpha` of another size than the frames.
    """
    given: tuple[tuple[ForegroundSource, np.ndarray | None], ...] = (("mask", mask), ("alpha", alpha))
    for source, coverage in given:
        if coverage is not None:
            return Foreground(mask=_binary(coverage, frames.shape[:3], source), source=source, confidence=1.0)
    small = _reduced(frames)
    found = _moving_silhouette(small)
    if found is None or found.confidence < _LEAST_CONFIDENCE:
        found = _plain_silhouette(small)
    if found is None or found.confidence < _LEAST_CONFIDENCE:
        whole = np.ones(frames.shape[:3], bool)
        return Foreground(mask=whole, source="whole_frame", confidence=0.0)
    full = _enlarged(found.coverage, frames.shape[1:3])
    return Foreground(mask=full, source="background_model", confidence=found.confidence)


def _moving_silhouette(frames: UInt8[np.ndarray, "T H W 3"]) -> _Silhouette | None:
    """The moving object; None if nothing moves, everything moves, or the result has an implausible size.

    The confidence is the steadiness of the area times the expected intersection over union, given the network's
    probabilities.
    """
    steady = stabilise(frames)
    window = moving_window(steady.frames)
    if window is None:
        return None
    from models.outline import refined_coverage  # loads torch, which a clip that comes with a mask does not need
    from models.segmenter import object_coverage

    part = np.ascontiguousarray(steady.frames[:, *window])
    coverage = np.zeros(frames.shape[:3], np.float32)
    coverage[:, *window] = refined_coverage(part, object_coverage(part))
    likely = coverage > 0.5
    mask = link_masks(likely, coverage.sum(axis=0))
    confidence = _steadiness(mask) * _expected_overlap(coverage, mask)
    coverage[likely & ~mask] = 0.0
    return _Silhouette(steady.undo((coverage * 255 + 0.5).astype(np.uint8)), confidence)


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


def _plain_silhouette(frames: UInt8[np.ndarray, "T H W 3"]) -> _Silhouette | None:
    masks = plain_background_masks(frames)
    return None if masks is None else _Silhouette(masks * np.uint8(255), _PLAIN_CONFIDENCE * _steadiness(masks))


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
    fitted = _smooth_field(image, border)
    residual = difference(image, fitted)
    threshold = max(_PLAIN_CONTRAST, 3.0 * float(np.quantile(residual[border], 0.8)))
    if threshold > 60:
        return None
    masks = [clean_mask(difference(planes[:, k], fitted) > threshold) for k in range(len(frames))]
    return link_masks(np.stack(masks), np.ones(masks[0].shape, np.float32))


def _smooth_field(image: Float32[np.ndarray, "3 H W"], border: Bool[np.ndarray, "H W"]) -> Float32[np.ndarray, "3 H W"]:
    """Second-order polynomial of the position through the border's colours."""
    height, width = border.shape
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    coefficients, *_ = np.linalg.lstsq(basis[border], image[:, border].T, rcond=None)
    return np.moveaxis(basis @ coefficients, -1, 0).astype(np.float32)


def _steadiness(mask: Bool[np.ndarray, "T H W"]) -> float:
    """Share of frames in which the area is close to the usual one; 0 if that is an implausible size."""
    areas = mask.reshape(len(mask), -1).mean(axis=1)
    typical = float(np.median(areas))
    if not _OBJECT_SHARE[0] <= typical <= _OBJECT_SHARE[1]:
        return 0.0
    return float(np.mean(np.abs(areas / typical - 1) < 0.35))


def _expected_overlap(coverage: Float32[np.ndarray, "T H W"], mask: Bool[np.ndarray, "T H W"]) -> float:
    """Expected intersection over union of the mask with a truth that has these pixel probabilities."""
    inside = float(coverage[mask].sum())
    union = float(mask.sum() + coverage[~mask].sum())
    return inside / union if union > 0 else 0.0


def _binary(coverage: np.ndarray, shape: tuple[int, ...], name: str) -> Bool[np.ndarray, "T H W"]:
    if coverage.shape != shape:
        raise InputError(f"{name}: got shape {coverage.shape}, expected {shape} (frames, height, width)")
    return coverage if coverage.dtype == bool else coverage > 127


def _reduced(frames: UInt8[np.ndarray, "T H W 3"]) -> UInt8[np.ndarray, "T h w 3"]:
    height, width = frames.shape[1:3]
    scale = min(1.0, _WORKING_SIDE / max(height, width))
    if scale == 1.0:
        return frames
    size = (max(8, round(width * scale)), max(8, round(height * scale)))
    return np.stack([shrink(frame, size) for frame in frames])


def _enlarged(coverage: UInt8[np.ndarray, "T h w"], size: tuple[int, int]) -> Bool[np.ndarray, "T H W"]:
    """Above one half after linear interpolation."""
    height, width = size
    return np.stack([cv2.resize(c, (width, height), interpolation=cv2.INTER_LINEAR) > 127 for c in coverage])


def clean_mask(mask: Bool[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """Open, close and fill holes."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, cross)
    closed = cv2.morphologyEx(opened, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    outlines, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    return cv2.drawContours(np.zeros_like(closed), outlines, -1, 1, cv2.FILLED) > 0


def link_masks(masks: Bool[np.ndarray, "T H W"], weight: Float32[np.ndarray, "H W"]) -> Bool[np.ndarray, "T H W"]:
    """Keep in each frame the component that continues its neighbour's, outward from the heaviest.

    A component weighs what `weight` sums to inside it.
    """
    parts = [cv2.connectedComponents(mask.astype(np.uint8), connectivity=8) for mask in masks]
    weights = [np.bincount(labels.ravel(), weight.ravel(), minlength=2)[1:] for _, labels in parts]
    start = int(np.argmax([heavy.max() for heavy in weights]))
    out = np.zeros_like(masks)
    for order in (range(start, len(masks)), range(start - 1, -1, -1)):
        previous = out[start] if order.step < 0 else None
        for k in order:
            count, labels = parts[k]
            if count < 2:
                continue
            merit = weights[k]
            if previous is not None:
                near = cv2.dilate(previous.view(np.uint8), np.ones((9, 9), np.uint8)) > 0
                merit = np.bincount(labels[near], weight[near], minlength=count)[1:] + 0.2 * merit
            out[k] = labels == 1 + int(merit.argmax())
            previous = out[k]
    return out
