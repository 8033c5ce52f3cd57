"""Inspect a video file without decoding it: validity and properties."""

import errno
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import av
import numpy as np
from av.stream import Disposition
from av.video.stream import VideoStream

from physconvex.io.video.result import VideoError

# A file may be a play list that refers elsewhere: never follow it beyond this machine's files.
OPEN_OPTIONS = {"protocol_whitelist": "file"}

_HDR_TRANSFERS = (16, 18)  # SMPTE ST 2084 (PQ), ARIB STD-B67 (HLG)
_ALPHA_DECODERS = {"vp8": "libvpx", "vp9": "libvpx-vp9"}  # the native decoders drop the alpha layer

# First bytes of containers that libav cannot open when their index or end is missing.
_CONTAINER_MARKS = (
    (4, b"ftyp"),
    (4, b"moov"),
    (4, b"mdat"),
    (0, b"\x1a\x45\xdf\xa3"),
    (0, b"RIFF"),
    (0, b"OggS"),
)


@dataclass(frozen=True)
class Probe:
    """Facts of the first video stream, from its header and its first frame."""

    codec: str
    pixel_format: str
    width: int  # [px] as stored, before rotation
    height: int  # [px]
    has_alpha: bool
    alpha_decoder: str | None  # name of the decoder that keeps the alpha layer, if another one is needed
    orientation: tuple[tuple[int, int], tuple[int, int]]  # signs of the display matrix
    pixel_aspect: float  # width of a stored pixel over its height
    header_frames: int  # 0: the header does not state it
    header_duration: float | None  # [s]
    rate: float | None  # [1/s] nominal
    equidistant: bool  # the index exists and all its frame times are equally spaced
    cut_short: bool  # the index points beyond the end of the file
    high_dynamic_range: bool

    @property
    def upright(self) -> bool:
        """No rotation or mirroring to apply."""
        return self.orientation == ((1, 0), (0, 1))


def check_file(path: Path) -> None:
    """Raise `VideoError` unless `path` is a readable file that is not empty."""
    try:
        status = path.stat()
        if stat.S_ISREG(status.st_mode):
            with path.open("rb"):
                pass
    except PermissionError:
        raise VideoError(path, "permission", "no permission to read it; change its mode or owner") from None
    except OSError as error:
        if error.errno == errno.ELOOP:
            detail = "the symbolic link leads back to itself, so there is no file; point it at one"
        elif path.is_symlink():
            detail = f"the symbolic link points to {os.readlink(path)}, which is not there"
        else:
            detail = f"cannot be opened: {error.strerror or error}; check the path"
        raise VideoError(path, "missing", detail) from None
    if not stat.S_ISREG(status.st_mode):
        raise VideoError(path, "not_a_video", "is not a regular file; expected a video file")
    if status.st_size == 0:
        raise VideoError(path, "empty_file", "the file is empty (0 bytes); copy or record it again")


def _open_error(path: Path, error: Exception) -> VideoError:
    """Meaning of a failed `av.open`, from the first bytes of the file."""
    if isinstance(error, PermissionError):
        return VideoError(path, "permission", "no permission to read it; change its mode or owner")
    with path.open("rb") as file:
        head = file.read(16)
    if any(head[start : start + len(mark)] == mark for start, mark in _CONTAINER_MARKS):
        detail = "a video container without its index (cut short, or recording was not finished); copy it again"
        return VideoError(path, "truncated", detail)
    return VideoError(path, "not_a_video", "its content is not a video in any known format")


def probe_video(path: Path) -> Probe:
    """Facts about a file that passed `check_file`; raises `VideoError`."""
    try:
        container = av.open(str(path.absolute()), options=OPEN_OPTIONS)
    except (av.FFmpegError, OSError, ValueError) as error:
        raise _open_error(path, error) from None
    with container:
        stream = video_stream(container)
        if stream is None:
            kinds = ", ".join(sorted({str(s.type) for s in container.streams if s.type != "video"}))
            raise VideoError(path, "no_video_stream", f"holds {kinds or 'nothing'} but no video stream")
        cut_short, equidistant = _index_facts(stream, path.stat().st_size)
        frame = _first_frame(container, stream, path, cut_short)
        return _facts(container, stream, frame, cut_short, equidistant)


def video_stream(container: av.container.InputContainer) -> VideoStream | None:
    """The first video stream that is not the cover picture of an audio file."""
    streams = (s for s in container.streams.video if not s.disposition & Disposition.attached_pic)
    return next(streams, None)


def _first_frame(
    container: av.container.InputContainer, stream: VideoStream, path: Path, cut_short: bool
) -> av.VideoFrame:
    reason = ""
    try:
        frame = next(container.decode(stream), None)
    except av.FFmpegError as error:
        frame, reason = None, error.strerror or type(error).__name__
    if frame is not None:
        return frame
    if cut_short:
        raise VideoError(path, "truncated", "the file ends before its first whole frame; copy it again")
    if not reason and stream.frames == 0:
        raise VideoError(path, "too_few_frames", "its video stream holds no frame")
    detail = f"not one frame could be decoded ({reason or 'no reason given'}); convert it to H.264"
    raise VideoError(path, "undecodable", detail)


def _index_facts(stream: VideoStream, file_size: int) -> tuple[bool, bool]:
    """(index points beyond the end of the file, index is complete and equidistant)."""
    entries = list(stream.index_entries)
    cut_short = any(entry.pos + entry.size > file_size for entry in entries)
    steps = np.diff([entry.timestamp for entry in entries])
    # Rates such as 29.97 in a coarse time base alternate between two neighbouring integers.
    equidistant = len(entries) > 1 and len(entries) == stream.frames and bool(np.ptp(steps) <= 1)
    return cut_short, equidistant


def _facts(
    container: av.container.InputContainer,
    stream: VideoStream,
    frame: av.VideoFrame,
    cut_short: bool,
    equidistant: bool,
) -> Probe:
    name = stream.codec_context.codec.canonical_name
    marked_alpha = stream.metadata.get("alpha_mode", stream.metadata.get("ALPHA_MODE")) == "1"
    aspect = stream.sample_aspect_ratio
    rate = stream.average_rate or stream.guessed_rate or stream.base_rate
    duration = None
    if stream.duration is not None and stream.time_base is not None:
        duration = float(stream.duration * stream.time_base)
    elif container.duration is not None and len(container.streams) == 1:
        duration = container.duration / av.time_base
    alpha_decoder = _ALPHA_DECODERS.get(name) if marked_alpha else None
    return Probe(
        codec=name,
        pixel_format=frame.format.name,
        width=frame.width,
        height=frame.height,
        has_alpha=alpha_decoder is not None or any(part.is_alpha for part in frame.format.components),
        alpha_decoder=alpha_decoder,
        orientation=_orientation(frame),
        pixel_aspect=float(aspect) if aspect else 1.0,
        header_frames=stream.frames,
        header_duration=duration,
        rate=float(rate) if rate else None,
        equidistant=equidistant,
        cut_short=cut_short,
        high_dynamic_range=frame.color_trc in _HDR_TRANSFERS,
    )


def _orientation(frame: av.VideoFrame) -> tuple[tuple[int, int], tuple[int, int]]:
    """The display matrix rounded to the nearest of the eight right-angled ones."""
    data = frame.side_data.get("DISPLAYMATRIX")
    if data is None:
        return (1, 0), (0, 1)
    matrix = np.frombuffer(cast(bytes, data), dtype=np.int32).reshape(3, 3)[:2, :2].astype(np.int64)
    if abs(matrix[0, 0]) >= abs(matrix[0, 1]):
        return (-1 if matrix[0, 0] < 0 else 1, 0), (0, -1 if matrix[1, 1] < 0 else 1)
    return (0, -1 if matrix[0, 1] < 0 else 1), (-1 if matrix[1, 0] < 0 else 1, 0)
