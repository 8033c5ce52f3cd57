"""Where the object is in each frame: opacity, a given mask, or a background model."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import UInt8

from models.background import background_silhouettes, plain_background_silhouettes
from physconvex.errors import InputError

__all__ = ["Foreground", "ForegroundSource", "locate_foreground"]

ForegroundSource = Literal["alpha", "mask", "background_model", "whole_frame"]

_WORKING_SIDE = 128  # [px]
_LEAST_CONFIDENCE = 0.2  # below it the whole frame is shown


@dataclass(frozen=True)
class Foreground:
    """The object's silhouette in each frame (0 or 255), how it was found and how sure that is (0..1)."""

    mask: UInt8[np.ndarray, "T H W"]
    source: ForegroundSource
    confidence: float


def locate_foreground(
    frames: UInt8[np.ndarray, "T H W 3"],
    *,
    alpha: np.ndarray | None = None,
    mask: np.ndarray | None = None,
) -> Foreground:
    """Silhouette of the one object in a clip of a fixed camera.

    A given `mask` [T, H, W] (bool, or 8 bits and above 127) is taken, else `alpha`, else what moves before a
    static background (`models.background`), else what differs from a plain one, else the whole frame with
    confidence 0.

    Raises:
        InputError: `mask` or `alpha` of another size than the frames.
    """
    given: tuple[tuple[ForegroundSource, np.ndarray | None], ...] = (("mask", mask), ("alpha", alpha))
    for source, coverage in given:
        if coverage is not None:
            return Foreground(mask=_binary(coverage, frames.shape[:3], source), source=source, confidence=1.0)
    small = _reduced(frames)
    found = background_silhouettes(small)
    if found is None or found.confidence < _LEAST_CONFIDENCE:
        found = plain_background_silhouettes(small)
    if found is None or found.confidence < _LEAST_CONFIDENCE:
        whole = np.full(frames.shape[:3], 255, np.uint8)
        return Foreground(mask=whole, source="whole_frame", confidence=0.0)
    full = _enlarged(found.mask, frames.shape[1:3])
    return Foreground(mask=full, source="background_model", confidence=found.confidence)


def _binary(coverage: np.ndarray, shape: tuple[int, ...], name: str) -> UInt8[np.ndarray, "T H W"]:
    if coverage.shape != shape:
        raise InputError(f"{name}: got shape {coverage.shape}, expected {shape} (frames, height, width)")
    if coverage.dtype == bool:
        return coverage.astype(np.uint8) * np.uint8(255)
    return ((coverage > 127) * np.uint8(255)).astype(np.uint8)


def _reduced(frames: UInt8[np.ndarray, "T H W 3"]) -> UInt8[np.ndarray, "T h w 3"]:
    height, width = frames.shape[1:3]
    scale = min(1.0, _WORKING_SIDE / max(height, width))
    if scale == 1.0:
        return frames
    size = (max(8, round(width * scale)), max(8, round(height * scale)))
    return np.stack([cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in frames])


def _enlarged(mask: UInt8[np.ndarray, "T h w"], size: tuple[int, int]) -> UInt8[np.ndarray, "T H W"]:
    height, width = size
    if mask.shape[1:] == size:
        return mask
    smooth = [cv2.resize(m, (width, height), interpolation=cv2.INTER_LINEAR) for m in mask]
    return np.stack([cv2.threshold(m, 127, 255, cv2.THRESH_BINARY)[1] for m in smooth])
