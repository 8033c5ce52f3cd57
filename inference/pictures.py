"""Pictures of a prediction: a strip of its frames with the found outline, a section through its skinning weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

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
_GRID = 56  # [px] of one map
_MAP_GAP = 4  # [px]
_COLUMNS = 5
_HANDLES_SHOWN = 10
_LOW, _MIDDLE, _HIGH = np.array([38, 102, 172]), np.array([244, 243, 240]), np.array([190, 52, 48])


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


def weight_maps(
    field: Callable[[Float[np.ndarray, "Q 3"]], Float32[np.ndarray, "Q M"]],
    silhouette: UInt8[np.ndarray, "S S"],
    object_size: float,
) -> bytes:
    """Return a PNG of the weights on the plane y = 0 of the object frame within a silhouette.

    Left: all weights at once, their three principal components as red, green and blue. Right: the first ten
    weights one by one, blue for the least, red for the greatest. Transparent outside the silhouette.

    Args:
        field: weights at points [m] of the object frame (x right in the image, z up, origin in the middle).
        silhouette: the object in the first frame, coverage 0..255; its box is taken as the rest box.
        object_size: largest edge of the rest bounding box [m].
    """
    inside = _fitted(silhouette)
    rows, columns = np.nonzero(inside)
    if len(rows) < 3:
        return b""
    plane = np.stack([columns + 0.5, rows + 0.5], axis=1) / _GRID - 0.5
    points = np.stack([plane[:, 0], np.zeros(len(rows)), -plane[:, 1]], axis=1) * object_size
    weights = np.asarray(field(points), np.float64)
    side = 2 * _GRID + _MAP_GAP
    whole = cv2.resize(_painted(inside, _principal_colours(weights)), (side, side), interpolation=cv2.INTER_CUBIC)
    maps = [_painted(inside, _diverging_colours(w)) for w in weights.T[:_HANDLES_SHOWN]]
    done, data = cv2.imencode(".png", cv2.cvtColor(_sheet(whole, maps), cv2.COLOR_RGBA2BGRA))
    assert done
    return data.tobytes()


def _fitted(silhouette: UInt8[np.ndarray, "S S"]) -> Bool[np.ndarray, "G G"]:
    """Cut out the silhouette's box and scale its larger edge to the grid, centred."""
    covered = silhouette > 127
    if not covered.any():
        return np.zeros((_GRID, _GRID), bool)
    rows, columns = np.flatnonzero(covered.any(axis=1)), np.flatnonzero(covered.any(axis=0))
    cut = silhouette[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    scale = _GRID / max(cut.shape)
    width, height = (max(1, round(length * scale)) for length in (cut.shape[1], cut.shape[0]))
    x, y = (_GRID - width) // 2, (_GRID - height) // 2
    fitted = np.zeros((_GRID, _GRID), bool)
    fitted[y : y + height, x : x + width] = cv2.resize(cut, (width, height)) > 127
    return fitted


def _principal_colours(weights: Float[np.ndarray, "Q M"]) -> UInt8[np.ndarray, "Q 3"]:
    centred = weights - weights.mean(axis=0)
    _, directions = np.linalg.eigh(centred.T @ centred)  # ascending; [M, M] is cheap, an SVD of [Q, M] is not
    principal = directions[:, ::-1][:, :3]
    scores = np.zeros((len(weights), 3))
    scores[:, : principal.shape[1]] = centred @ principal
    spread = scores.std(axis=0)
    scores /= np.where(spread > 1e-9, spread, 1.0)
    return (255 * (0.55 + 0.2 * scores).clip(0, 1)).round().astype(np.uint8)


def _diverging_colours(weight: Float[np.ndarray, " Q"]) -> UInt8[np.ndarray, "Q 3"]:
    span = max(float(np.ptp(weight)), 1e-9)
    share = ((weight - weight.min()) / span)[:, None]
    low = _LOW + (_MIDDLE - _LOW) * np.minimum(1, 2 * share)
    return (low + (_HIGH - _MIDDLE) * np.maximum(0, 2 * share - 1)).round().astype(np.uint8)


def _painted(inside: Bool[np.ndarray, "G G"], colours: UInt8[np.ndarray, "Q 3"]) -> UInt8[np.ndarray, "G G 4"]:
    picture = np.zeros((_GRID, _GRID, 4), np.uint8)
    picture[inside, :3], picture[inside, 3] = colours, 255
    return picture


def _sheet(whole: UInt8[np.ndarray, "N N 4"], maps: list[UInt8[np.ndarray, "G G 4"]]) -> UInt8[np.ndarray, "N W 4"]:
    columns = min(_COLUMNS, len(maps))
    step = _GRID + _MAP_GAP
    sheet = np.zeros((len(whole), len(whole) + 3 * _MAP_GAP + columns * step - _MAP_GAP, 4), np.uint8)
    sheet[:, : len(whole)] = whole
    for k, picture in enumerate(maps):
        y, x = (k // _COLUMNS) * step, len(whole) + 3 * _MAP_GAP + (k % _COLUMNS) * step
        sheet[y : y + _GRID, x : x + _GRID] = picture
    return sheet
