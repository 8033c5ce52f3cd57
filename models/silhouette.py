"""Kinematics of a silhouette: its position, size and stretch, frame by frame."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

MOMENT_NAMES = (
    "centroid_x",
    "centroid_y",
    "left",
    "right",
    "bottom",
    "top",
    "sqrt_area",
    "sxx",
    "sxy",
    "syy",
    "touches_border",
)

_FRAMES_FOR_UNIT = 3


@dataclass(frozen=True)
class Silhouettes:
    """Moments of each frame (columns: `MOMENT_NAMES`) and which frames have no silhouette."""

    moments: Float32[np.ndarray, "T M"]
    empty: Bool[np.ndarray, " T"]


def silhouette_moments(
    mask: UInt8[np.ndarray, "T H W"], *, touches_border: Bool[np.ndarray, " T"] | None = None
) -> Silhouettes:
    """Dimensionless moments of soft masks (0..255 = coverage), with sub-pixel resolution.

    The unit of length is the larger edge of the bounding box, median over the first three frames that hold
    a silhouette; the origin is the centroid in the first of them; x to the right, y upward. `sxx`, `sxy`,
    `syy` are central second moments over the area; `sqrt_area` the root of the area. `touches_border` is
    copied (1 = the silhouette is cut off by the picture). A frame without a silhouette repeats the one
    before it (leading ones the first that has one); without any silhouette all is zero.
    """
    raw = _pixel_moments(mask)
    empty = raw[:, 6] < 1.0
    present = np.flatnonzero(~empty)
    result = np.zeros((len(mask), len(MOMENT_NAMES)))
    if len(present) > 0:
        source = present[np.maximum(np.searchsorted(present, np.arange(len(mask)), side="right") - 1, 0)]
        result[:, :10] = _dimensionless(raw[source], raw[present[:_FRAMES_FOR_UNIT]])
    if touches_border is not None:
        result[:, 10] = touches_border
    return Silhouettes(moments=result.astype(np.float32), empty=empty)


def _dimensionless(raw: Float64[np.ndarray, "T 10"], first: Float64[np.ndarray, "K 10"]) -> Float64[np.ndarray, "T 10"]:
    unit = float(np.median(np.maximum(first[:, 3] - first[:, 2], first[:, 4] - first[:, 5])))
    unit = max(unit, 1.0)
    origin = first[0, :2]
    out = np.empty_like(raw)
    out[:, 0], out[:, 1] = (raw[:, 0] - origin[0]) / unit, (origin[1] - raw[:, 1]) / unit
    out[:, 2:4] = (raw[:, 2:4] - origin[0]) / unit
    out[:, 4:6] = (origin[1] - raw[:, 4:6]) / unit
    out[:, 6] = np.sqrt(raw[:, 6]) / unit
    out[:, 7:10] = raw[:, 7:10] / unit**2 * [1.0, -1.0, 1.0]
    return out


def _pixel_moments(mask: UInt8[np.ndarray, "T H W"]) -> Float64[np.ndarray, "T 10"]:
    """Centroid x, y; left, right, bottom, top; area; xx, xy, yy in pixels, y down, pixel centres at +0.5."""
    weight = mask.astype(np.float32) / 255.0
    x = np.arange(mask.shape[2], dtype=np.float32) + 0.5
    y = np.arange(mask.shape[1], dtype=np.float32) + 0.5
    columns, rows = weight.sum(axis=1, dtype=np.float64), weight.sum(axis=2, dtype=np.float64)
    area = rows.sum(axis=1)
    safe = np.maximum(area, 1e-9)
    cx, cy = columns @ x / safe, rows @ y / safe
    dx, dy = x[None] - cx[:, None], y[None] - cy[:, None]
    moments = np.empty((len(mask), 10))
    moments[:, 0], moments[:, 1], moments[:, 6] = cx, cy, area
    moments[:, 2], moments[:, 3] = _edges(mask.max(axis=1))
    moments[:, 5], moments[:, 4] = _edges(mask.max(axis=2))
    moments[:, 7] = (columns * dx**2).sum(axis=1) / safe
    moments[:, 8] = np.einsum("tw,tw->t", np.einsum("th,thw->tw", dy, weight, optimize=True), dx) / safe
    moments[:, 9] = (rows * dy**2).sum(axis=1) / safe
    return moments


def _edges(profile: UInt8[np.ndarray, "T N"]) -> tuple[Float64[np.ndarray, " T"], Float64[np.ndarray, " T"]]:
    """Ends of each profile's outermost half-covered pixels: a pixel of coverage c adds c of its width."""
    cover = profile.astype(np.float64) / 255.0
    inside = cover >= 0.5
    first, last = inside.argmax(axis=1), inside.shape[1] - 1 - inside[:, ::-1].argmax(axis=1)
    frames = np.arange(len(profile))
    padded = np.pad(cover, ((0, 0), (1, 1)))
    low = first + 1.0 - cover[frames, first] - padded[frames, first] * (padded[frames, first] < 0.5)
    high = last + cover[frames, last] + padded[frames, last + 2] * (padded[frames, last + 2] < 0.5)
    return low, high
