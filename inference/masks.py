"""Masks of a capture's videos, found by the network that `predict` uses: the command `physconvex masks`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from jaxtyping import Bool, UInt8
from PIL import Image

from physconvex import InputError
from physconvex.io import Capture, command, load_capture, whole_file, write_mask

_DOUBTFUL = 0.5  # confidence below which a user is asked to look
_HEIGHT = 240  # of the pictures of the sheet [px]


def find_masks(
    capture: Capture | str | Path, cameras: Sequence[str] | None = None, *, redo: bool = False
) -> Iterator[tuple[str, float | InputError]]:
    """Find the moving object in the videos of a capture and write `CAMERA_mask.mp4` beside each.

    Yields each camera with the confidence of its masks, 0 … 1, or with the error that says why there are none; a mask
    that is there already is kept, with confidence 1. `masks.jpg` shows the outlines in the first, middle and last
    frame of each camera.

    Args:
        cameras: names; all with a video unless given.
        redo: whether masks that are there are found anew.

    Raises:
        InputError: no such camera, or no camera with a video.
    """
    capture = capture if isinstance(capture, Capture) else load_capture(capture)
    chosen = [c.name for c in capture.filmed] if cameras is None else [capture.camera(n).name for n in cameras]
    if not chosen:
        raise InputError(f"{capture.folder}: no camera has a video; masks of single pictures cannot be found")
    shown = []
    for name in chosen:
        frames = capture.video(name).frames
        masks, confidence = None if redo else capture.mask(name), 1.0
        if masks is None:
            try:
                masks, confidence = _found(name, frames)
                write_mask(capture.folder / f"{name}_mask", masks, fps=capture.fps)
            except InputError as error:
                yield name, error
                continue
        shown.append(_strip(frames, masks))
        yield name, confidence
    if shown:
        with whole_file(capture.folder / "masks.jpg") as partial:
            width = max(strip.shape[1] for strip in shown)
            sheet = [np.pad(strip, ((0, 0), (0, width - strip.shape[1]), (0, 0))) for strip in shown]
            Image.fromarray(np.concatenate(sheet)).save(partial, format="JPEG")


def _found(name: str, frames: UInt8[np.ndarray, "T H W 3"]) -> tuple[Bool[np.ndarray, "T H W"], float]:
    from models import sharp_foreground  # loads torch

    found = sharp_foreground(frames)
    if not found.confidence or not found.mask[0].any():
        raise InputError(
            f"camera {name!r}: no object is found that moves before a still background; add {name}_mask.mp4 yourself"
        )
    return found.mask, found.confidence


def _strip(frames: UInt8[np.ndarray, "T H W 3"], masks: Bool[np.ndarray, "T H W"]) -> UInt8[np.ndarray, "h w 3"]:
    """The outlines in the first, middle and last frame."""
    width = round(_HEIGHT * frames.shape[2] / frames.shape[1])
    pictures = []
    for k in (0, len(frames) // 2, len(frames) - 1):
        outlines, _ = cv2.findContours(masks[k].astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        drawn = cv2.drawContours(frames[k].copy(), outlines, -1, (0, 255, 0), max(1, frames.shape[1] // _HEIGHT))
        pictures.append(cv2.resize(drawn, (width, _HEIGHT), interpolation=cv2.INTER_AREA))
    return np.concatenate(pictures, axis=1)


@command
def masks_command(
    *,
    capture: Annotated[Path, typer.Argument(help="Capture folder; the masks are written into it.", show_default=False)],
    camera: Annotated[list[str] | None, typer.Option(help="Camera with a video; repeatable. Default: all.")] = None,
    redo: Annotated[bool, typer.Option("--redo", help="Find masks anew that are there already.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print only the confidences, as JSON.")] = False,
) -> None:
    """Find the moving object in the videos of a capture and write its masks, CAMERA_mask.mp4.

    The camera and the background have to stand still. masks.jpg shows the outlines: look at it.
    """
    confidences, failed = {}, 0
    for name, found in find_masks(capture, camera, redo=redo):
        failed += isinstance(found, InputError)
        confidences[name] = str(found) if isinstance(found, InputError) else round(found, 3)
        if not as_json:
            doubt = "" if isinstance(found, InputError) or found >= _DOUBTFUL else " (doubtful: look at masks.jpg)"
            print(found if isinstance(found, InputError) else f"camera {name}: confidence {found:.2f}{doubt}")
    if as_json:
        print(json.dumps(confidences))
    elif failed < len(confidences):
        print(f"look at: {capture / 'masks.jpg'}")
    if failed:
        raise typer.Exit(1)
