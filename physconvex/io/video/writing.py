"""Write H.264 files whose bytes depend only on the frames."""

import itertools
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from physconvex.errors import InputError
from physconvex.io.whole_files import whole_file

# With macroblock trees x264 reads uninitialised memory, unless the width is a multiple of this [px]: the same frames
# then give different bytes from one call to the next (seen with x264 165 at widths of 48 to 240 px).
_MACROBLOCK_TREE_WIDTH = 128


def write_video(
    path: Path | str, frames: np.ndarray | Iterable[np.ndarray], *, fps: float, crf: int = 18, preset: str = "medium"
) -> None:
    """Write frames (uint8 RGB, shape [T, H, W, 3]) as H.264 (yuv420p, mp4), atomically and bit-deterministically.

    One encoder thread and no dates: the same frames give the same bytes. The file appears under its name
    only when it is complete. `crf` is the constant rate factor, 0 (lossless) to 51.

    Raises:
        InputError: no frames, wrong shape or dtype, odd width or height (H.264 with shared chroma has
            none), fps that is not positive.
    """
    path = Path(path)
    if not (np.isfinite(fps) and fps > 0):
        raise InputError(f"fps: got {fps!r}, expected a positive number of frames per second")
    with whole_file(path) as partial:
        _encode(partial, frames, Fraction(fps).limit_denominator(100_000), crf, preset)


def _encode(path: Path, frames: Iterable[np.ndarray], rate: Fraction, crf: int, preset: str) -> None:
    iterator = iter(frames)
    first = next(iterator, None)
    if first is None:
        raise InputError("frames: got none, expected at least one frame")
    height, width = _check_frame(first, None)
    options = {"movflags": "+faststart", "fflags": "+bitexact"}
    encoder = {"crf": str(crf), "preset": preset}
    if width % _MACROBLOCK_TREE_WIDTH:
        encoder["x264-params"] = "mbtree=0"
    with av.open(str(path), "w", format="mp4", options=options) as container:
        stream = container.add_stream("libx264", rate=rate, options=encoder)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.codec_context.thread_count = 1
        for frame in itertools.chain([first], iterator):
            _check_frame(frame, (height, width))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")))
        container.mux(stream.encode(None))


def _check_frame(frame: np.ndarray, expected: tuple[int, int] | None) -> tuple[int, int]:
    if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8:
        raise InputError(f"frames: got a frame {frame.dtype} {frame.shape}, expected uint8 [H, W, 3]")
    height, width = frame.shape[:2]
    if expected is not None and (height, width) != expected:
        raise InputError(f"frames: got {width}x{height} after {expected[1]}x{expected[0]}, expected one size")
    if height % 2 or width % 2:
        raise InputError(f"frames: got {width}x{height}, expected even width and height; crop or pad one pixel")
    return height, width
