"""Patches of a video: of the still background, and of the moving surface of the body.

A patch of the body in a later picture is compared with the same surface in the first one, mapped to its pose by the
affine map of the points around it. Only statistics are compared, so the two need not match to the pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from physconvex.gap.effects.effect import Patches
from physconvex.gap.thresholds import PICTURES
from physconvex.identify import PixelObservations

Grey = Float[np.ndarray, "T H W"]
Outline = Bool[np.ndarray, "H W"]
HALF = 5  # half of the side of a compared patch [pixels]
_GAMMA = 2.2  # display gamma: light = (value / 255)^2.2
_MARGIN = 16  # margin around it for content that an open shutter brings in [pixels]
_NEIGHBOURS = 8  # number of points that define the affine map of a patch
_SPACING = 16  # spacing of background patches [pixels]


@dataclass(frozen=True, eq=False)
class Compared:
    """Patches as observed, and as a short, even exposure would show them.

    Attributes:
        frames: frame of each, shape [N].
        seen: observed light, shape [N, h, w].
        sharp: the first picture's light in the pose of that frame, with a margin on all sides.
    """

    frames: Int[np.ndarray, " N"]
    seen: Float[np.ndarray, "N h w"]
    sharp: Patches


def light_of(frames: UInt8[np.ndarray, "T H W 3"]) -> Grey:
    """Light, 0 to 1, of pictures."""
    grey = np.stack([cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in frames])
    return np.asarray((grey / 255.0) ** _GAMMA)


def still_patches(light: Grey, seen: PixelObservations, fps: float, outline: Outline) -> Compared:
    """Patches of a background grid that the body covers neither in the first picture nor in that frame.

    A completely white background is also used: it shows darkening, though not brightening. `outline` is the place of
    the body in the first picture.
    """
    height, width = light.shape[1:]
    grids = np.arange(HALF, height - HALF, _SPACING), np.arange(HALF, width - HALF, _SPACING)
    rows, columns = (grid.ravel() for grid in np.meshgrid(*grids, indexing="ij"))
    near = cv2.dilate(outline.astype(np.uint8), np.ones((4 * HALF + 1, 4 * HALF + 1), np.uint8)) > 0
    rows, columns = rows[~near[rows, columns]], columns[~near[rows, columns]]
    first = _cut(light[0], rows, columns)
    values = 255 * first.mean((1, 2)) ** (1 / _GAMMA)
    told = (values > PICTURES.dark) & (values < PICTURES.bright)
    if not told.any():
        told = values > PICTURES.dark
    at, patches, references = [], [], []
    for frame in range(1, len(light)):
        free = told & ~_covered(seen.pixels[0], seen.pixels[frame], outline, rows, columns)
        at += [frame] * int(free.sum())
        patches.append(_cut(light[frame], rows[free], columns[free]))
        references.append(first[free])
    frames = np.array(at, dtype=int)
    sharp = Patches(np.concatenate(references), np.zeros((len(frames), 2)), frames / fps)
    return Compared(frames, np.concatenate(patches), sharp)


def _cut(light: Float[np.ndarray, "H W"], rows: np.ndarray, columns: np.ndarray) -> Float[np.ndarray, "N h w"]:
    offsets = np.arange(-HALF, HALF + 1)
    return np.asarray(light[rows[:, None, None] + offsets[:, None], columns[:, None, None] + offsets])


def _covered(
    first: Float[np.ndarray, "P 2"], points: Float[np.ndarray, "P 2"], outline: Outline, rows: np.ndarray,
    columns: np.ndarray,
) -> Bool[np.ndarray, " N"]:  # fmt: skip
    """Whether the body may cover patches, from the widened box of the points; all patches if no point is known."""
    known = np.isfinite(points).all(1)
    if not known.any() or not outline.any():
        return np.ones(len(rows), dtype=bool)
    filled = np.argwhere(outline)[:, ::-1]
    beyond = max((first[known].min(0) - filled.min(0)).max(), (filled.max(0) - first[known].max(0)).max(), 0.0)
    room = PICTURES.around * beyond + 2 * HALF
    low, high = points[known].min(0) - room, points[known].max(0) + room
    return np.asarray((columns > low[0]) & (columns < high[0]) & (rows > low[1]) & (rows < high[1]))


def body_patches(light: Grey, seen: PixelObservations, fps: float, outline: Outline) -> Compared:
    """Patches about the tracked points that the body fills in the first picture, where it has this `outline`."""
    inner = cv2.erode(outline.astype(np.uint8), np.ones((2 * HALF + 1, 2 * HALF + 1), np.uint8)) > 0
    places = seen.pixels[0] - 0.5  # in pixel centres
    height, width = light.shape[1:]
    nearest = np.round(places).clip(0, [width - 1, height - 1]).astype(int)
    kept = np.flatnonzero(inner[nearest[:, 1], nearest[:, 0]])
    speeds = _velocities(seen.pixels, fps)
    start = PICTURES.faster * fps * np.nanmedian(np.linalg.norm(seen.pixels[1] - seen.pixels[0], axis=1))
    frames, patches, references, velocities = [], [], [], []
    for point in kept.tolist():
        for frame in range(1, len(light)):
            pose, row, column = _pose(seen.pixels, point, frame), *_at(seen.pixels[frame, point])
            far = min(row, column, height - 1 - row, width - 1 - column) < HALF
            if pose is None or far or not np.linalg.norm(speeds[frame, point]) > start:
                continue
            frames.append(frame)
            patches.append(light[frame, row - HALF : row + HALF + 1, column - HALF : column + HALF + 1])
            references.append(_posed(light[0], places[point], pose))
            velocities.append(speeds[frame, point])
    count, wide = len(frames), 2 * (HALF + _MARGIN) + 1
    return Compared(
        np.array(frames, dtype=int),
        np.array(patches).reshape(count, 2 * HALF + 1, 2 * HALF + 1),
        Patches(
            np.array(references).reshape(count, wide, wide),
            np.array(velocities).reshape(count, 2),
            np.array(frames, dtype=float) / fps,
        ),
    )


def _at(pixel: Float[np.ndarray, " 2"]) -> tuple[int, int]:
    """Row and column; −1 if unknown."""
    if not np.isfinite(pixel).all():
        return -1, -1
    return int(np.floor(pixel[1])), int(np.floor(pixel[0]))


def _velocities(pixels: Float[np.ndarray, "T P 2"], fps: float) -> Float[np.ndarray, "T P 2"]:
    """Central differences [pixels/s], one-sided at the last frame that shows the point; NaN in the first one."""
    out = np.full_like(pixels, np.nan)
    out[1:] = pixels[1:] - pixels[:-1]
    middle = 0.5 * (pixels[2:] - pixels[:-2])
    out[1:-1] = np.where(np.isfinite(middle), middle, out[1:-1])
    return fps * out


def _pose(pixels: Float[np.ndarray, "T P 2"], point: int, frame: int) -> Float[np.ndarray, "2 2"] | None:
    """Affine map of the surroundings of a point from the first picture to another; None if unknown."""
    known = np.flatnonzero(np.isfinite(pixels[frame]).all(1))
    if point not in known or len(known) <= 4:
        return None
    arms = pixels[0, known] - pixels[0, point]
    near = np.argsort((arms**2).sum(1))[: _NEIGHBOURS + 1]
    solved, _, rank, _ = np.linalg.lstsq(arms[near], (pixels[frame, known] - pixels[frame, point])[near], rcond=None)
    turned = solved.T
    return turned if rank == 2 and 0.3 < np.linalg.det(turned) < 3.0 else None


def _posed(image: Float[np.ndarray, "H W"], place: Float[np.ndarray, " 2"], pose: np.ndarray) -> np.ndarray:
    """The surroundings of a place (x, y) in a pose, with the margin."""
    side = HALF + _MARGIN
    back = np.linalg.inv(pose)
    warp = np.hstack([back, (place - back @ [side, side])[:, None]])
    size = (2 * side + 1, 2 * side + 1)
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(image, warp, size, flags=flags, borderMode=cv2.BORDER_REPLICATE))
