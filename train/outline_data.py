"""Clips with rough and true silhouettes for the outline network: read once, disturbed again for every step."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from models import object_coverage
from train.records import LabelledClip
from train.segmentation_data import MaskedClip, moving_part, read_masked_clips

_RESIZED = 0.5  # share of clips whose rough silhouette is grown or shrunk by a pixel
_PATCHED = 0.3  # share in which patches of it are filled or emptied in single frames
_MISTAKEN = 0.3  # share in which one place is filled or emptied in all frames


@dataclass(frozen=True)
class RoughClip(MaskedClip):
    """The part of the picture in which something moves, the true mask, and the coverage that the segmenter finds."""

    rough: UInt8[np.ndarray, "T H W"]

    @property
    def coverage(self) -> Float32[np.ndarray, "T H W"]:
        """0..1."""
        return self.rough.astype(np.float32) / 255


def read_rough_clips(
    clips: Iterable[LabelledClip], *, progress: Callable[[int], None] | None = None
) -> list[RoughClip]:
    """As `models.foreground` has them when it asks for the outline; calls `progress` with the number read."""
    out = []
    for clip in clips:
        (steady,) = read_masked_clips([clip])
        part = moving_part(steady).each(np.ascontiguousarray)
        rough = (object_coverage(part.frames) * 255 + 0.5).astype(np.uint8)
        out.append(RoughClip(part.frames, part.mask, rough))
        if progress is not None:
            progress(len(out))
    return out


def degraded(clip: RoughClip, generator: np.random.Generator) -> RoughClip:
    """With a rough silhouette that is worse than the segmenter's."""
    rough = clip.rough
    draw = generator.random()
    if draw < _RESIZED:
        change = cv2.dilate if draw < _RESIZED / 2 else cv2.erode
        rough = np.stack([change(r, np.ones((3, 3), np.uint8)) for r in rough])
    if generator.random() < _PATCHED:
        rough = _patched(rough, generator)
    if generator.random() < _MISTAKEN:
        rough = _mistaken(rough, generator)
    return replace(clip, rough=rough)


def _patched(rough: UInt8[np.ndarray, "T H W"], generator: np.random.Generator) -> UInt8[np.ndarray, "T H W"]:
    """Up to three discs at the silhouette filled or emptied."""
    rough = rough.copy()
    height, width = rough.shape[1:]
    for _ in range(generator.integers(1, 4)):
        frame = rough[generator.integers(0, len(rough))]
        inside = np.flatnonzero(frame > 127)
        if len(inside) == 0:
            continue
        y, x = np.array(divmod(int(generator.choice(inside)), width)) + generator.integers(-10, 11, 2)
        place = (int(np.clip(x, 0, width - 1)), int(np.clip(y, 0, height - 1)))
        cv2.circle(frame, place, int(generator.integers(2, 8)), int(generator.choice([0, 255])), -1)
    return rough


def _mistaken(rough: UInt8[np.ndarray, "T H W"], generator: np.random.Generator) -> UInt8[np.ndarray, "T H W"]:
    """A soft disc on the path of the object, filled or (mostly) emptied: the object appears as background there."""
    height, width = rough.shape[1:]
    inside = np.flatnonzero(rough.max(axis=0) > 127)
    if len(inside) == 0:
        return rough
    y, x = divmod(int(generator.choice(inside)), width)
    radius = generator.uniform(0.1, 0.4) * np.sqrt((rough > 127).sum(axis=(1, 2)).max())
    rows, columns = np.ogrid[:height, :width]
    distance = np.hypot(rows - y, columns - x) / max(radius, 1.0)
    keep = np.clip(2 * distance - 1.5, 0, 1)
    changed = rough * keep + (255 * (1 - keep) if generator.random() < 0.25 else 0)
    return changed.astype(np.uint8)
