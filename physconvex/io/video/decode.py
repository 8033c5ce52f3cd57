"""Decode the frames of one probed file, in order, by decord or by PyAV."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import av
import numpy as np
from jaxtyping import Float64, UInt8

from physconvex.io.video.probe import OPEN_OPTIONS, Probe, video_stream
from physconvex.io.video.result import VideoError

# Where decord 0.6 returns the same bytes as PyAV: tests/io/test_video.py compares them.
_DECORD_CODECS = ("h264",)
_DECORD_FORMATS = ("yuv420p", "yuvj420p")


@dataclass(frozen=True)
class Limits:
    """How much of a video may be decoded."""

    max_frames: int | None
    max_seconds: float | None  # [s]
    max_side: int | None  # [px]
    max_bytes: int


@dataclass(frozen=True)
class Decoded:
    """Frames [T,H,W,3 or 4] and the times [T] in s that the container states (None: none)."""

    frames: UInt8[np.ndarray, "T H W C"]
    timestamps: Float64[np.ndarray, " T"] | None
    more: bool  # the limits ended the decoding
    broken: str  # reason of an early end, empty if none


def suits_decord(probe: Probe, limits: Limits) -> bool:
    """True for plain 8-bit H.264 with upright square pixels, a full index and no limit to apply."""
    within = limits.max_frames is None or probe.header_frames <= limits.max_frames
    seconds = limits.max_seconds
    within &= seconds is None or (probe.header_duration or np.inf) <= seconds
    plain = probe.codec in _DECORD_CODECS and probe.pixel_format in _DECORD_FORMATS
    plain &= probe.upright and probe.pixel_aspect == 1.0 and not probe.has_alpha
    whole = probe.equidistant and not probe.cut_short
    return plain and whole and within and output_size(probe, limits.max_side) == (probe.width, probe.height)


def decode_decord(path: Path, probe: Probe) -> Decoded | None:
    """All frames by decord; None if decord is not installed, fails, or disagrees with the header."""
    try:
        import decord
    except ImportError:  # no wheel for this platform: PyAV reads everything
        return None
    try:
        threads = 0 if _pays_threads(probe) else 1
        reader = decord.VideoReader(str(path.absolute()), ctx=decord.cpu(0), num_threads=threads)
        if len(reader) != probe.header_frames:
            return None
        frames = reader.get_batch(range(len(reader))).asnumpy()
        times = reader.get_frame_timestamp(range(len(reader)))[:, 0].astype(np.float64)
    except (decord.DECORDError, RuntimeError, IndexError):
        return None
    if frames.shape != (probe.header_frames, probe.height, probe.width, 3):
        return None
    return Decoded(frames=frames, timestamps=times, more=False, broken="")


def decode_pyav(path: Path, probe: Probe, limits: Limits) -> Decoded:
    """Frames in order up to the limits; a broken end is reported, not raised."""
    width, height = output_size(probe, limits.max_side)
    channels = 4 if probe.has_alpha else 3
    _check_memory(path, probe, limits, width * height * channels)
    images: list[np.ndarray] = []
    times: list[float | None] = []
    more, broken, used = False, "", 0
    with av.open(str(path.absolute()), options=OPEN_OPTIONS) as container:
        try:
            for frame in _frames(container, probe):
                if _enough(images, times, frame, limits):
                    more = True
                    break
                images.append(_image(frame, width, height, channels))
                times.append(frame.time)
                used += images[-1].nbytes
                if used > limits.max_bytes:
                    raise _too_large(path, len(images), width, height, limits)
        except av.FFmpegError as error:
            broken = error.strerror or type(error).__name__
    if not images:
        raise VideoError(path, "undecodable", f"not one frame could be decoded ({broken}); convert it to H.264")
    known = [time for time in times if time is not None]
    stamps = np.array(known, dtype=np.float64) if len(known) == len(times) else None
    return Decoded(frames=_orient(np.stack(images), probe), timestamps=stamps, more=more, broken=broken)


def output_size(probe: Probe, max_side: int | None) -> tuple[int, int]:
    """(width, height) in pixels before rotation: square pixels, longer side at most `max_side`."""
    width, height = probe.width * probe.pixel_aspect, float(probe.height)
    scale = min(1.0, max_side / max(width, height)) if max_side is not None else 1.0
    return max(1, round(width * scale)), max(1, round(height * scale))


def _frames(container: av.container.InputContainer, probe: Probe) -> Iterator[av.VideoFrame]:
    stream = video_stream(container)
    assert stream is not None  # the probe found it
    if probe.alpha_decoder is None:
        stream.thread_type = "AUTO" if _pays_threads(probe) else "NONE"
        yield from container.decode(stream)
        return
    decoder = cast(av.VideoCodecContext, av.CodecContext.create(probe.alpha_decoder, "r"))
    for packet in container.demux(stream):
        yield from decoder.decode(packet)


def _pays_threads(probe: Probe) -> bool:
    """Frame threads pay for large pictures only."""
    return probe.width * probe.height > 2**20


def _enough(images: list[np.ndarray], times: list[float | None], frame: av.VideoFrame, limits: Limits) -> bool:
    if limits.max_frames is not None and len(images) >= limits.max_frames:
        return True
    if limits.max_seconds is None or not times or times[0] is None or frame.time is None:
        return False
    return bool(frame.time - times[0] >= limits.max_seconds)


def _image(frame: av.VideoFrame, width: int, height: int, channels: int) -> UInt8[np.ndarray, "H W C"]:
    name = "rgba" if channels == 4 else "rgb24"
    # One conversion thread: more make small pictures two times slower on a busy machine.
    if (frame.width, frame.height) != (width, height):
        frame = frame.reformat(width=width, height=height, format=name, interpolation="AREA", threads=1)
    return frame.to_ndarray(format=name, threads=1)


def _orient(frames: UInt8[np.ndarray, "T H W C"], probe: Probe) -> UInt8[np.ndarray, "T _ _ C"]:
    """Apply the display matrix: (x, y) of the stored picture goes to (x, y) @ matrix."""
    (a, b), (c, d) = probe.orientation
    if a:
        across, down = a, d
    else:
        frames, across, down = frames.transpose(0, 2, 1, 3), c, b
    return np.ascontiguousarray(frames[:, ::down, ::across])


def _check_memory(path: Path, probe: Probe, limits: Limits, frame_bytes: int) -> None:
    """Reject a video that is known to be too large, before decoding."""
    counts = [probe.header_frames or None, limits.max_frames]
    if limits.max_seconds is not None and probe.rate is not None:
        counts.append(int(np.ceil(limits.max_seconds * probe.rate)))
    frames = min((count for count in counts if count is not None), default=1)
    if frames * frame_bytes > limits.max_bytes:
        raise _too_large(path, frames, *output_size(probe, limits.max_side), limits)


def _too_large(path: Path, frames: int, width: int, height: int, limits: Limits) -> VideoError:
    detail = (
        f"{frames} frames of {width}x{height} need more than the {limits.max_bytes / 2**20:.0f} MiB allowed; "
        "cut the video or make its pictures smaller (of read_video: give a smaller max_side, max_frames or max_seconds)"
    )
    return VideoError(path, "too_large", detail)
