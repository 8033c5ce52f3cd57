"""Masks of a video that do not show the whole object, or not the state at t = 0: what is then done."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool

from physconvex import InputError
from physconvex.io import Camera, Capture

_SAME = 0.95  # least share of the joint area that two masks of one state have in common


def check_masks(capture: Capture, camera: Camera, mask: Bool[np.ndarray, "T H W"]) -> tuple[str, ...]:
    """Notes on the masks of a camera's observed frames.

    Args:
        capture: the capture.
        camera: of the video.
        mask: of the observed frames.

    Raises:
        InputError: the mask of frame 0 is empty.
    """
    name = camera.name
    if not mask[0].any():
        raise InputError(
            f"camera {name!r}: its mask is empty in frame 0, which shows the body at t = 0; correct {name}_mask.mp4, "
            "or choose other cameras (--camera)"
        )
    notes = []
    empty = ~mask.any(axis=(1, 2))
    if empty.any():
        notes.append(
            f"Camera {name}: its mask is empty in {_frames(np.flatnonzero(empty))}; these frames have no outline of it."
        )
    rim = mask[:, [0, -1]].any(axis=(1, 2)) | mask[:, :, [0, -1]].any(axis=(1, 2))
    if rim.any():
        notes.append(
            f"Camera {name}: the object leaves the picture in {_frames(np.flatnonzero(rim))}; only the part of its "
            "outline inside the picture is fitted."
        )
    first = capture.first_mask(name)
    if first is not None:
        common = float((first & mask[0]).sum() / (first | mask[0]).sum())
        if common < _SAME:
            notes.append(
                f"Camera {name}: {name}_mask.png and frame 0 of its video show different states (the masks have "
                f"{100 * common:.0f} % of their area in common). The body is that of the picture, its motion that of "
                "the video; frame 0 must show the state at t = 0."
            )
    return tuple(notes)


def _frames(numbers: Iterable[int]) -> str:
    """Frames in words: "frames 3 to 5, 9"."""
    runs: list[list[int]] = []
    for number in map(int, numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    many = len(runs) > 1 or runs[0][0] < runs[0][1]
    return ("frames " if many else "frame ") + ", ".join(
        str(first) if first == last else f"{first} to {last}" for first, last in runs
    )
