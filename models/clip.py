"""Frames of any size and rate -> the network's input; shared by training and inference."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8
from pydantic import model_validator

from models.downscaling import halvings, shrink
from models.foreground import Foreground, ForegroundSource, locate_foreground
from models.silhouette import MOMENT_NAMES, silhouette_moments
from models.windows import GREY, object_windows
from physconvex import InputError
from physconvex.io import Options

_SURE = 0.5  # confidence of the foreground
_LEAD_FRAMES = 2  # shown before the motion begins
_THUMBNAIL = 64  # [px]


class ClipConfig(Options):
    """Format of the input of the network."""

    image_size: int = 112
    """Edge of the fixed square in which silhouettes are measured [px]."""
    window: int = 80
    """Edge of the windows that follow the object [px]."""
    extent: float = 1.7
    """Edge of these windows, in units of the longer edge of the first silhouette."""
    frames: int = 24
    target_fps: float = 24.0
    """Frame rate to which a clip is resampled [1/s]."""
    margin: float = 0.1
    """Margin around the path of the object, relative to its longer edge."""

    @model_validator(mode="after")
    def _check(self) -> ClipConfig:
        large = self.image_size >= 8 and self.window >= 8 and self.extent > 0 and self.margin >= 0
        if not large or self.frames < 2 or not self.target_fps > 0:
            raise InputError(
                f"ClipConfig: got {self!r}, expected image_size >= 8, window >= 8, extent > 0, frames >= 2, "
                "target_fps > 0, margin >= 0"
            )
        return self


@dataclass(frozen=True)
class PreparedClip:
    """The object's path in a fixed square, and its pictures in windows that follow it."""

    windows: UInt8[np.ndarray, "T W W 4"]  # RGB, mid-grey outside the object unless the whole frame is shown; coverage
    mask: UInt8[np.ndarray, "T S S"]  # coverage 0..255 in the fixed square
    moments: Float32[np.ndarray, "T M"]  # columns: MOMENT_NAMES
    valid: Bool[np.ndarray, " T"]  # False = repeats the last frame of a clip that is too short
    fps: float  # [1/s] rate of these frames
    foreground: ForegroundSource
    confidence: float  # 0..1, of the foreground
    crop: tuple[int, int, int]  # x0, y0, side [px of the source]
    source_frames: int
    start_time: float  # [s] of the first frame shown, since the first frame of the source
    warnings: tuple[str, ...] = ()


def prepare_clip(
    frames: np.ndarray,
    *,
    fps: float = 24.0,
    timestamps: np.ndarray | None = None,
    mask: np.ndarray | None = None,
    alpha: np.ndarray | None = None,
    config: ClipConfig | None = None,
) -> PreparedClip:
    """Resample in time, find the object, measure its path in a fixed square, crop windows that follow it.

    Args:
        frames: 8-bit RGB, shape [T, H, W, 3].
        fps: rate [1/s], used unless `timestamps` are given.
        timestamps: times [s], shape [T], increasing; the rate may vary.
        mask: the object (bool, or 8 bits and above 127), shape [T, H, W]; overrides everything else.
        alpha: opacity, 8 bits, shape [T, H, W]; used unless `mask` is given.
        config: size, length and rate of the result.

    A video longer than the window is shown from just before the motion (`start_time`); a shorter one repeats its last
    frame with `valid` False. The output rate is the source's divided by a whole number (`resample`): no frame is
    interpolated or repeated.

    Raises:
        InputError: wrong shape or dtype, fewer than two frames, times that do not increase.
    """
    config = config or ClipConfig()
    times = _checked_times(frames, fps, timestamps)
    selection = resample(times, target_fps=config.target_fps)
    chosen, warnings = selection.indices, []
    if len(chosen) > config.frames:
        start = motion_start(frames, chosen, length=config.frames)
        warnings.append(f"shows {config.frames} of {len(chosen)} frames, from {times[chosen[start]]:.3g} s on")
        chosen = chosen[start : start + config.frames]
    shown = frames[chosen]
    foreground = locate_foreground(
        shown, alpha=None if alpha is None else alpha[chosen], mask=None if mask is None else mask[chosen]
    )
    if foreground.source == "whole_frame":
        warnings.append("no object was found: the answer is of the whole picture and says little; give a mask")
    elif foreground.confidence < _SURE:
        warnings.append(f"the object was found with a confidence of {foreground.confidence:.2f}: look at its outline")
    crop = _crop_square(foreground, config.margin, config.image_size)
    images, masks = _cut_out(shown, foreground, crop, config.image_size)
    silhouettes = silhouette_moments(masks, touches_border=touches_border(foreground.mask))
    if silhouettes.empty.any():
        warnings.append(f"the object is not seen in {int(silhouettes.empty.sum())} of {len(chosen)} frames")
    padding = config.frames - len(chosen)
    windows = object_windows(images, masks, size=config.window, extent=config.extent)
    return PreparedClip(
        windows=_pad(windows, padding),
        mask=_pad(masks, padding),
        moments=_pad(silhouettes.moments, padding),
        valid=np.arange(config.frames) < len(chosen),
        fps=selection.fps,
        foreground=foreground.source,
        confidence=foreground.confidence,
        crop=crop,
        source_frames=len(frames),
        start_time=float(times[chosen[0]] - times[0]),
        warnings=tuple(warnings),
    )


def shuffle_time(clip: PreparedClip, *, generator: np.random.Generator) -> PreparedClip:
    """The clip in random frame order: windows, masks and moments permuted together.

    Moments refer to the first frame, which changes, so that they are measured again.
    """
    return _reorder(clip, generator.permutation(len(clip.mask)))


def freeze_time(clip: PreparedClip, *, frame: int = 0) -> PreparedClip:
    """The clip as if nothing moved: one frame, repeated."""
    return _reorder(clip, np.full(len(clip.mask), frame))


def _reorder(clip: PreparedClip, order: np.ndarray) -> PreparedClip:
    masks = clip.mask[order]
    touches = clip.moments[order, MOMENT_NAMES.index("touches_border")] > 0.5
    moments = silhouette_moments(masks, touches_border=touches).moments
    return replace(clip, windows=clip.windows[order], mask=masks, moments=moments, valid=clip.valid[order])


def _checked_times(frames: np.ndarray, fps: float, timestamps: np.ndarray | None) -> Float64[np.ndarray, " T"]:
    if frames.ndim != 4 or frames.shape[3] != 3 or frames.dtype != np.uint8:
        raise InputError(f"frames: got {frames.dtype} {frames.shape}, expected uint8 [T, H, W, 3] (RGB)")
    if len(frames) < 2:
        raise InputError(f"frames: got {len(frames)}, expected at least two; one picture holds no motion")
    if timestamps is None:
        if not (np.isfinite(fps) and fps > 0):
            raise InputError(f"fps: got {fps!r}, expected a positive number of frames per second")
        return np.arange(len(frames)) / fps
    times = np.asarray(timestamps, dtype=np.float64)
    if times.shape != (len(frames),) or not np.all(np.diff(times) > 0):
        raise InputError(f"timestamps: got shape {times.shape}, expected {len(frames)} increasing times [s]")
    return times


@dataclass(frozen=True)
class FrameSelection:
    """Indices of source frames, equally spaced in time at `fps`."""

    indices: Int64[np.ndarray, " N"]
    fps: float  # [1/s]


def resample(timestamps: Float64[np.ndarray, " T"], *, target_fps: float) -> FrameSelection:
    """Every n-th frame of a video of constant rate; the nearest frames of one with a variable rate.

    With a constant rate the spacing is exact: the result has the source rate divided by the whole number that brings it
    closest to `target_fps` (25 -> 25, 60 -> 30, 240 -> 24). A variable rate is sampled at `target_fps`, or at its mean
    rate if that is lower.
    """
    steps = np.diff(timestamps)
    rate = len(steps) / (timestamps[-1] - timestamps[0])
    if np.ptp(steps) <= 0.25 * np.median(steps):
        stride = max(1, round(rate / target_fps))
        return FrameSelection(indices=np.arange(0, len(timestamps), stride), fps=float(rate / stride))
    fps = float(min(rate, target_fps))
    times = timestamps[0] + np.arange(int((timestamps[-1] - timestamps[0]) * fps + 1e-6) + 1) / fps
    middles = (timestamps[1:] + timestamps[:-1]) / 2
    return FrameSelection(indices=np.searchsorted(middles, times).astype(np.int64), fps=fps)


def motion_start(frames: UInt8[np.ndarray, "T H W 3"], indices: Int64[np.ndarray, " N"], *, length: int) -> int:
    """Position in `indices` at which a window of `length` frames begins: just before the motion.

    Motion is a change above the noise in a thumbnail's frame differences. Without motion the result is 0; the window
    never extends beyond the last frame.
    """
    size = (_THUMBNAIL, _THUMBNAIL)
    small = [cv2.resize(frames[i], size, interpolation=cv2.INTER_AREA).mean(axis=2) for i in indices]
    change = np.abs(np.diff(np.stack(small).astype(np.float32), axis=0)).reshape(len(small) - 1, -1)
    strength = np.partition(change, -20, axis=1)[:, -20]  # the 20th largest of 4096 pixels
    threshold = max(6.0, 3.0 * float(np.quantile(strength, 0.1)))
    moving = np.flatnonzero(strength > threshold)
    first = int(moving[0]) if len(moving) else 0
    return max(0, min(first - _LEAD_FRAMES, len(indices) - length))


def _crop_square(foreground: Foreground, margin: float, size: int) -> tuple[int, int, int]:
    """x0, y0, side [px] of the square around the object's whole path; may extend beyond the image.

    The side can be halved as often as the scaling to `size` needs (`models.downscaling`).
    """
    height, width = foreground.mask.shape[1:]
    union = np.asarray(foreground.mask.any(axis=0))
    columns, rows = np.asarray(union.any(axis=0)), np.asarray(union.any(axis=1))
    if foreground.source == "whole_frame" or not columns.any():
        side = max(width, height)
        return (width - side) // 2, (height - side) // 2, side
    x0, x1 = int(columns.argmax()), width - int(columns[::-1].argmax())
    y0, y1 = int(rows.argmax()), height - int(rows[::-1].argmax())
    side = max(4, round(max(x1 - x0, y1 - y0) * (1 + 2 * margin)))
    side += -side % 2 ** halvings(side, size)
    return round((x0 + x1 - side) / 2), round((y0 + y1 - side) / 2), side


def _cut_out(
    frames: UInt8[np.ndarray, "T H W 3"], foreground: Foreground, crop: tuple[int, int, int], size: int
) -> tuple[UInt8[np.ndarray, "T S S 3"], UInt8[np.ndarray, "T S S"]]:
    """Crop, grey out, scale; area averages make the scaled mask a coverage."""
    x0, y0, side = crop
    height, width = frames.shape[1:3]
    inside = np.s_[max(0, y0) : min(height, y0 + side), max(0, x0) : min(width, x0 + side)]
    target = np.s_[inside[0].start - y0 : inside[0].stop - y0, inside[1].start - x0 : inside[1].stop - x0]
    canvas_image = np.empty((side, side, 3), np.uint8)
    canvas_mask = np.zeros((side, side), np.uint8)
    images, masks = (
        np.empty((len(frames), size, size, 3), np.uint8),
        np.empty((len(frames), size, size), np.uint8),
    )
    for k, (frame, mask) in enumerate(zip(frames, foreground.mask, strict=True)):
        canvas_image[...] = GREY
        seen = mask[inside] * np.uint8(255)
        canvas_mask[target] = seen
        cv2.copyTo(np.ascontiguousarray(frame[inside]), seen, canvas_image[target])
        images[k], masks[k] = _scaled(canvas_image, size), _scaled(canvas_mask, size)
    return images, masks


def _scaled(picture: np.ndarray, size: int) -> np.ndarray:
    if len(picture) >= size:
        return shrink(picture, (size, size))
    return cv2.resize(picture, (size, size), interpolation=cv2.INTER_LINEAR)


def touches_border(mask: Bool[np.ndarray, "T H W"]) -> Bool[np.ndarray, " T"]:
    """Frames in which the picture cuts the silhouette off."""
    sides = (mask[:, 0], mask[:, -1], mask[:, :, 0], mask[:, :, -1])
    return np.any([side.any(axis=1) for side in sides], axis=0)


def _pad(array: np.ndarray, count: int) -> np.ndarray:
    return np.concatenate([array, np.repeat(array[-1:], count, axis=0)]) if count else array
