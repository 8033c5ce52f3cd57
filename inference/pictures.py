"""A strip of the frames of a prediction, with the found outline of the object."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8

from inference.loading import LoadedClip
from models import PreparedClip


@dataclass(frozen=True)
class ClipPictures:
    """Encoded pictures of one clip; empty where there is none."""

    frames: bytes = b""
    """JPEG of the frames used, with the outline of the object."""
    weights: bytes = b""
    """PNG of the skinning weights."""


_OUTLINE = (0, 200, 255)  # RGB
_GAP = 3  # [px] between two pictures
_PAPER = 255


def frame_strip(loaded: LoadedClip, prepared: PreparedClip, *, count: int = 8, side: int = 128) -> bytes:
    """Return a JPEG of `count` square pictures [side px] from the shown time, cut as the network sees them.

    The pictures are the clip's own, background included; the line is the border of the found foreground.
    """
    used = int(prepared.valid.sum())
    chosen = np.unique(np.linspace(0, used - 1, min(count, used)).round().astype(int))
    sources = shown_source_frames(loaded, prepared)[chosen]
    tiles = [
        _tile(loaded.frames[index], prepared.mask[k], prepared.crop, side)
        for k, index in zip(chosen, sources, strict=True)
    ]
    gap = np.full((side, _GAP, 3), _PAPER, np.uint8)
    strip = np.concatenate([part for tile in tiles for part in (tile, gap)][:-1], axis=1)
    done, data = cv2.imencode(".jpg", cv2.cvtColor(strip, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 85])
    assert done
    return data.tobytes()


def shown_source_frames(loaded: LoadedClip, prepared: PreparedClip) -> np.ndarray:
    """Return the indices of the clip's frames nearest to the times the network sees, shape [T]."""
    fps = loaded.fps
    assert fps is not None, "a prepared clip has a rate"
    times = np.arange(len(loaded.frames)) / fps if loaded.timestamps is None else loaded.timestamps
    shown = times[0] + prepared.start_time + np.arange(len(prepared.valid)) / prepared.fps
    middles = (times[1:] + times[:-1]) / 2
    return np.searchsorted(middles, shown)


def _tile(
    frame: UInt8[np.ndarray, "H W 3"],
    mask: UInt8[np.ndarray, "S S"],
    crop: tuple[int, int, int],
    side: int,
) -> UInt8[np.ndarray, "N N 3"]:
    x0, y0, edge = crop
    height, width = frame.shape[:2]
    cut = frame[max(0, y0) : min(height, y0 + edge), max(0, x0) : min(width, x0 + edge)]
    borders = (max(0, -y0), max(0, y0 + edge - height), max(0, -x0), max(0, x0 + edge - width))
    square = cv2.copyMakeBorder(cut, *borders, cv2.BORDER_CONSTANT, value=(_PAPER,) * 3)
    method = cv2.INTER_AREA if edge > side else cv2.INTER_LINEAR
    tile = cv2.resize(square, (side, side), interpolation=method)
    cover = cv2.resize(mask, (side, side), interpolation=cv2.INTER_LINEAR)
    contours, _ = cv2.findContours((cover > 127).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(tile, contours, -1, _OUTLINE, 1, cv2.LINE_AA)
    return tile
