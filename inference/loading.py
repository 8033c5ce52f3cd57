"""Read one clip of any kind into frames with the conditions of its motion."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from inference.settings import StatedConditions
from inference.sources import ClipSource, displayed_path
from physconvex import InputError
from physconvex.io import CAPTURE_FILE, Capture, Video, load_capture, read_capture_file, read_image_sequence, read_video

DEFAULT_FPS = 24.0
"""Frames per second assumed for arrays and image folders without a stated rate [1/s]."""
DEFAULT_DENSITY = 1000.0
"""Density assumed where none is given [kg/m³]."""
DEFAULT_OBJECT_SIZE = 1.0
"""Largest edge of the object's rest bounding box assumed where none is given [m]."""
_GRAVITY = 9.81  # [m/s²]
MAX_SIDE = 1280
"""Larger frames are scaled down to this longer side while they are decoded [px]."""


@dataclass(frozen=True, kw_only=True)
class LoadedClip:
    """Frames of one clip and the conditions of the motion that its files state."""

    frames: UInt8[np.ndarray, "T H W 3"]
    fps: float | None
    """Frames per second [1/s]; None if the source has no clock."""
    timestamps: Float64[np.ndarray, " T"] | None = None
    """Times of the frames [s], for variable frame rates."""
    mask: Bool[np.ndarray, "T H W"] | None = None
    alpha: UInt8[np.ndarray, "T H W"] | None = None
    density: float | None = None
    object_size: float | None = None
    warnings: tuple[str, ...] = ()
    truncated: str = ""
    """One line that names a truncated file and states what is missing (also a warning); else empty."""

    def with_mask(self, mask: object) -> LoadedClip:
        """Return the clip with this foreground, shape [T, H, W], instead of its own.

        Raises:
            InputError: the mask has another shape than the frames.
        """
        return replace(self, mask=_as_mask(mask, self.frames.shape[:3]), alpha=None)


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """The numbers that convert dimensionless stiffness to pascals, and the assumed ones among them."""

    fps: float
    density: float
    object_size: float
    assumed: tuple[str, ...]


def resolve_conditions(loaded: LoadedClip, settings: StatedConditions) -> Conditions:
    """Return the user's value, else the clip's own, else the default (which is then named in `assumed`)."""
    assumed = []

    def choose(name: str, given: float | None, own: float | None, default: float, unit: str) -> float:
        value = given if given is not None else own
        if value is None:
            assumed.append(f"{name}={default:g} {unit}")
            return default
        return float(value)

    fps = choose("fps", settings.fps, loaded.fps, DEFAULT_FPS, "1/s")
    density = choose("density", settings.density, loaded.density, DEFAULT_DENSITY, "kg/m^3")
    object_size = choose("object_size", settings.object_size, loaded.object_size, DEFAULT_OBJECT_SIZE, "m")
    return Conditions(fps=fps, density=density, object_size=object_size, assumed=tuple(assumed))


def retimed(loaded: LoadedClip, fps: float) -> LoadedClip:
    """Return the clip played at `fps`: its timestamps are stretched, their unevenness kept."""
    if loaded.timestamps is None or loaded.fps is None:
        return replace(loaded, fps=fps)
    return replace(loaded, fps=fps, timestamps=loaded.timestamps * (loaded.fps / fps))


def load_clip(source: ClipSource) -> LoadedClip:
    """Read a video file, a capture folder or an image folder.

    Raises:
        InputError: the clip cannot be read; the message names the file and the cause.
    """
    if source.kind == "capture":
        return _load_capture(source.path)
    if source.kind == "images":
        return _load_images(source.path)
    return _load_video(source.path)


def _load_video(path: Path) -> LoadedClip:
    video = read_video(path, max_side=MAX_SIDE)
    mask_path = path.with_stem(path.stem + "_mask")
    mask = _read_mask_video(mask_path, video.frames.shape[:3]) if mask_path.is_file() else None
    truncated, warnings = _named(displayed_path(path), video)
    return LoadedClip(
        frames=video.frames,
        fps=float(video.fps),
        timestamps=video.timestamps,
        mask=mask,
        alpha=video.alpha,
        warnings=warnings,
        truncated=truncated,
    )


def _named(name: str, video: Video) -> tuple[str, tuple[str, ...]]:
    """Missing part and warnings of a video, with the file named if it is truncated."""
    if not video.truncated:
        return "", tuple(video.warnings)
    line = f"{name}: {video.truncated}"
    return line, tuple(line if warning == video.truncated else warning for warning in video.warnings)


def _read_mask_video(path: Path, shape: tuple[int, ...]) -> Bool[np.ndarray, "T H W"]:
    video = read_video(path, max_side=MAX_SIDE)
    mask = np.asarray(video.frames[..., 0] > 127)
    if mask.shape != shape:
        if video.truncated:
            raise InputError(f"{path}: {video.truncated}")
        raise InputError(
            f"{path}: the mask has frames, height, width {mask.shape}, its video has {shape}; "
            "expected the same. Write the mask from the same frames, or remove it."
        )
    return mask


def _load_capture(folder: Path) -> LoadedClip:
    """Read the observed frames of a capture's first camera; the later ones are to be predicted."""
    capture = load_capture(folder)
    stated = read_capture_file(folder / CAPTURE_FILE).model_fields_set
    if not capture.recorded:
        raise InputError(f"{folder}: the capture has no camera; prediction needs a video. Add one to {CAPTURE_FILE}.")
    name, count = _used(capture), capture.observed_frames
    video, mask = capture.video(name), capture.mask(name)
    truncated, warnings = _named(f"{displayed_path(folder)}: camera {name!r}", video)
    return LoadedClip(
        frames=video.frames[:count],
        fps=capture.fps,
        timestamps=capture.times[:count],
        mask=None if mask is None else mask[:count],
        density=capture.density if "density" in stated else None,
        object_size=capture.object_size,
        warnings=(*warnings, *_capture_warnings(capture)),
        truncated=truncated,
    )


def _used(capture: Capture) -> str:
    """Name of the first camera with images, or with missing ones."""
    return (capture.filmed or capture.recorded)[0].name


def _capture_warnings(capture: Capture) -> list[str]:
    warnings = []
    if len(capture.filmed) > 1:
        warnings.append(f"camera {_used(capture)!r} was used, the first of {len(capture.filmed)}")
    gravity = float(np.linalg.norm(capture.gravity))
    if abs(gravity / _GRAVITY - 1) > 0.01:
        warnings.append(f"gravity is {gravity:.3g} m/s^2, the predictor was trained with {_GRAVITY} m/s^2")
    return warnings


def _load_images(folder: Path) -> LoadedClip:
    images = read_image_sequence(folder, fps=DEFAULT_FPS)
    return LoadedClip(frames=images.frames, fps=None, alpha=images.alpha, warnings=tuple(images.warnings))


def load_array(
    array: object, *, mask: object = None, fps: float | None = None, timestamps: object = None
) -> LoadedClip:
    """Turn an array of frames into a clip.

    Args:
        array: numpy array or torch tensor of shape [T, H, W, 3 or 4], uint8 or floating point in [0, 1];
            a fourth channel is alpha (0 = background), unless it is opaque everywhere.
        mask: boolean foreground, shape [T, H, W].
        fps: frames per second [1/s]; None if unknown.
        timestamps: times of the frames [s], shape [T]; they determine fps.

    Raises:
        InputError: wrong shape, type or range.
    """
    values = _as_numpy(array)
    if values.ndim != 4 or values.shape[-1] not in (3, 4) or 0 in values.shape:
        raise InputError(
            f"frames has shape {values.shape}; expected [T, H, W, 3] or [T, H, W, 4]. "
            "Move the colour channels last and repeat a grey channel three times."
        )
    pixels = _as_uint8(values)
    alpha = pixels[..., 3] if pixels.shape[-1] == 4 else None
    if alpha is not None and alpha.min() == 255:
        alpha = None  # opaque everywhere, as in most RGBA arrays: no information
    times = None if timestamps is None else _as_times(timestamps, len(pixels))
    if times is not None and len(times) > 1:
        fps = float((len(times) - 1) / (times[-1] - times[0]))
    return LoadedClip(
        frames=np.ascontiguousarray(pixels[..., :3]),
        fps=fps,
        timestamps=times,
        mask=None if mask is None else _as_mask(mask, pixels.shape[:3]),
        alpha=alpha,
    )


def _as_numpy(array: object) -> np.ndarray:
    if "torch" in sys.modules:  # torch is not imported for this: processes that only read clips stay light
        from torch import Tensor

        if isinstance(array, Tensor):
            return array.detach().cpu().numpy()
    return np.asarray(array)


def _as_uint8(values: np.ndarray) -> UInt8[np.ndarray, "T H W C"]:
    if values.dtype == np.uint8:
        return values
    if not np.issubdtype(values.dtype, np.floating):
        raise InputError(
            f"frames has type {values.dtype}; expected uint8, or floating point in [0, 1]. Convert it first."
        )
    low, high = float(values.min()), float(values.max())
    if not (low >= 0.0 and high <= 1.0):  # also catches NaN
        raise InputError(
            f"frames has values from {low:g} to {high:g}; expected floating point in [0, 1]. "
            "Divide by the largest value, or pass uint8."
        )
    return np.round(values * 255.0).astype(np.uint8)


def _as_mask(mask: object, shape: tuple[int, ...]) -> Bool[np.ndarray, "T H W"]:
    values = _as_numpy(mask)
    if values.shape != shape:
        raise InputError(f"mask has shape {values.shape}; expected {shape} like the frames. Pass one mask per frame.")
    return values.astype(bool)


def _as_times(timestamps: object, count: int) -> Float64[np.ndarray, " T"]:
    times = _as_numpy(timestamps).astype(np.float64)
    if times.shape != (count,) or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise InputError(
            f"timestamps has shape {times.shape}; expected {count} increasing, finite times [s]. "
            "Pass one time per frame."
        )
    return times
