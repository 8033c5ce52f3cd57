"""Read a folder of numbered images as a video."""

import re
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from physconvex.errors import InputError
from physconvex.io.video.result import Video, VideoError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")


def read_image_sequence(folder: Path | str, *, fps: float) -> Video:
    """Frames from the PNG and JPEG files of a folder, in the order of the numbers at the end of their names.

    If two or more names have a number, images without one are ignored; otherwise the order is alphabetical. PNG alpha
    is kept.

    Raises:
        VideoError: no folder, fewer than two images, an unreadable image, images of different sizes.
        InputError: `fps` [1/s] is not positive.
    """
    folder = Path(folder)
    if not (np.isfinite(fps) and fps > 0):
        raise InputError(f"fps: got {fps!r}, expected a positive number of frames per second")
    try:
        paths = _in_order([path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES])
    except PermissionError:
        raise VideoError(folder, "permission", "no permission to list the folder") from None
    except OSError as error:
        raise VideoError(folder, "missing", f"cannot be listed: {error.strerror}; expected a folder") from None
    if len(paths) < 2:
        raise VideoError(folder, "too_few_frames", f"holds {len(paths)} PNG or JPEG images; at least 2 needed")
    images = [read_image(path) for path in paths]
    for path, image in zip(paths, images, strict=True):
        if image.shape != images[0].shape:
            height, width = images[0].shape[:2]
            size = f"{image.shape[1]}x{image.shape[0]}"
            detail = f"is {size}, the first image is {width}x{height}; expected one size"
            raise VideoError(path, "undecodable", detail)
    rgba = np.stack(images)
    alpha = None if rgba[..., 3].min() == 255 else np.ascontiguousarray(rgba[..., 3])
    times = np.arange(len(images)) / fps
    return Video(frames=np.ascontiguousarray(rgba[..., :3]), fps=float(fps), timestamps=times, alpha=alpha)


def _in_order(paths: list[Path]) -> list[Path]:
    """`f2` before `f10`, whose names differ by more than their numbers by these first."""
    ends = {path: re.search(r"^(.*?)(\d+)$", path.stem) for path in paths}
    numbered = [(end[1], int(end[2]), path.name, path) for path, end in ends.items() if end]
    return [entry[-1] for entry in sorted(numbered)] if len(numbered) > 1 else sorted(paths)


def read_image(path: Path) -> np.ndarray:
    try:
        with Image.open(path) as image:
            if image.mode.startswith("I"):  # 16-bit grey: Pillow would clip, not scale
                grey = (np.asarray(image, dtype=np.float64) / 65535 * 255).round().astype(np.uint8)
                return np.dstack([grey, grey, grey, np.full_like(grey, 255)])
            return np.asarray(image.convert("RGBA"))
    except PermissionError:
        raise VideoError(path, "permission", "no permission to read the image") from None
    except (UnidentifiedImageError, OSError) as error:
        raise VideoError(path, "undecodable", f"not a readable image ({error})") from None
