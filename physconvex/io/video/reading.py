"""Read a video file of any size, rate and orientation."""

from pathlib import Path
from typing import Literal

import av
import numpy as np
from jaxtyping import Float64

from physconvex.errors import InputError
from physconvex.io.video.decode import Decoded, Limits, decode_decord, decode_pyav, suits_decord
from physconvex.io.video.probe import Probe, check_file, probe_video
from physconvex.io.video.result import Video, VideoError

VideoBackend = Literal["auto", "decord", "pyav"]

MIN_FRAMES = 2  # one picture shows no motion
MIN_FRAMES_TRUNCATED = 8  # fewer frames before the cut are an error, more are used with a warning
MAX_STORED_PIXELS = 8192 * 8192  # one stored frame; libav holds several of them while decoding

av.logging.set_level(None)  # libav's messages become VideoError or Video.warnings


def read_video(
    path: Path | str,
    *,
    max_frames: int | None = 2000,
    max_seconds: float | None = None,
    max_side: int | None = None,
    max_bytes: int = 2 * 2**30,
    backend: VideoBackend = "auto",
) -> Video:
    """Decode a video file into upright 8-bit RGB frames with their times.

    Plain 8-bit H.264 is read by decord if it is installed, everything else (AV1, 10 bit, alpha, rotated, variable rate,
    truncated, downscaled) by PyAV; both give the same bytes. Decoding is sequential, without seeking. Sub-sampled,
    grey, 10-bit and palette pictures become 8-bit RGB; non-square pixels become square.

    Args:
        path: the file.
        max_frames: decode at most this many frames (from the start); `Video.warnings` reports it.
        max_seconds: the same for a time [s].
        max_side: frames with a longer side [px] are scaled down to it while decoding.
        max_bytes: bound on the size of the decoded frames [bytes]; peak memory is about twice that.
        backend: "auto", or one decoder for comparison; "decord" falls back to PyAV if it cannot decode.

    Raises:
        VideoError: with one `cause` for each kind of bad file. A truncated file is read up to the cut with a warning if
        at least 8 frames come before it, else it is an error.
        InputError: for a limit that is not positive.
    """
    limits = Limits(max_frames=max_frames, max_seconds=max_seconds, max_side=max_side, max_bytes=max_bytes)
    _check_limits(limits)
    path = Path(path)
    check_file(path)
    probe = probe_video(path)
    if probe.width * probe.height > MAX_STORED_PIXELS:
        raise VideoError(path, "too_large", f"frames of {probe.width}x{probe.height} pixels; at most 8192x8192")
    decoded = _decode(path, probe, limits, backend)
    return _video(path, probe, decoded, limits)


def _check_limits(limits: Limits) -> None:
    for name, value in vars(limits).items():
        if value is not None and not value > 0:
            raise InputError(f"{name}: got {value!r}, expected a positive number or None")
    if limits.max_frames is not None and limits.max_frames < MIN_FRAMES:
        raise InputError(f"max_frames: got {limits.max_frames}, expected at least {MIN_FRAMES}")


def _decode(path: Path, probe: Probe, limits: Limits, backend: VideoBackend) -> Decoded:
    size = probe.header_frames * probe.width * probe.height * 3
    if backend != "pyav" and suits_decord(probe, limits) and size <= limits.max_bytes:
        decoded = decode_decord(path, probe)
        if decoded is not None:
            return decoded
    return decode_pyav(path, probe, limits)


def _video(path: Path, probe: Probe, decoded: Decoded, limits: Limits) -> Video:
    count = len(decoded.frames)
    timestamps, fps, warnings = _times(probe, decoded)
    if decoded.more:
        warnings.append(f"only the first {count} frames ({timestamps[-1]:.2f} s) were read")
    cut = _cut_short(probe, decoded, timestamps)
    if cut and count < MIN_FRAMES_TRUNCATED and not decoded.more:
        detail = f"cut short: {count} whole frames, at least {MIN_FRAMES_TRUNCATED} needed; copy it again"
        raise VideoError(path, "truncated", detail)
    if count < MIN_FRAMES:
        raise VideoError(path, "too_few_frames", f"holds {count} frame; motion needs at least {MIN_FRAMES}")
    truncated = _missing(probe, count, timestamps) if cut else ""
    if cut:
        warnings.append(truncated)
    if probe.high_dynamic_range:
        warnings.append("high dynamic range: colours are used without tone mapping")
    frames, alpha = decoded.frames, None
    if probe.has_alpha:
        frames, alpha = np.ascontiguousarray(frames[..., :3]), np.ascontiguousarray(frames[..., 3])
        alpha = None if alpha.min() == 255 else alpha
    return Video(
        frames=frames, fps=fps, timestamps=timestamps, alpha=alpha, warnings=tuple(warnings), truncated=truncated
    )


def _times(probe: Probe, decoded: Decoded) -> tuple[Float64[np.ndarray, " T"], float, list[str]]:
    """Times from the first frame on [s], rate [1/s] and warnings about them."""
    count, stated = len(decoded.frames), decoded.timestamps
    if stated is None or (count > 1 and not np.all(np.diff(stated) > 0)):
        rate = probe.rate or 24.0
        origin = "states no frame times" if stated is None else "states frame times that do not increase"
        return np.arange(count) / rate, rate, [f"the file {origin}: {rate:g} frames per second assumed"]
    timestamps = stated - stated[0]
    if count < 2:
        return timestamps, probe.rate or 24.0, []
    mean, steps = float((count - 1) / timestamps[-1]), np.diff(timestamps)
    if np.ptp(steps) > 0.25 * np.median(steps):
        rates = f"{1 / steps.max():.3g} to {1 / steps.min():.3g} per second"
        return timestamps, mean, [f"variable frame rate ({rates})"]
    if probe.rate is not None and abs(probe.rate / mean - 1) < 0.01:  # header: exact; times: rounded
        return np.arange(count) / probe.rate, probe.rate, []
    return timestamps, mean, []


def _missing(probe: Probe, count: int, timestamps: Float64[np.ndarray, " T"]) -> str:
    """One line that states how much of a truncated file is decoded."""
    if probe.header_frames:
        decoded = f"{count} of {probe.header_frames} frames"
    elif probe.header_duration is not None:
        decoded = f"{count} frames ({timestamps[-1]:.2f} of {probe.header_duration:.2f} s)"
    else:
        decoded = f"{count} frames"
    return f"the file is cut short or damaged, {decoded} decoded: copy it again [truncated]"


def _cut_short(probe: Probe, decoded: Decoded, timestamps: Float64[np.ndarray, " T"]) -> bool:
    if decoded.broken or probe.cut_short:
        return True
    if decoded.more or probe.header_duration is None or len(timestamps) < 2:
        return False
    step = float(np.median(np.diff(timestamps)))
    missing = probe.header_duration - (timestamps[-1] + step)
    return bool(missing > max(2.5 * step, 0.1 * probe.header_duration))
