"""The first frames of a capture as observations of the object at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physconvex import InputError
from physconvex.io import Camera, Capture
from physconvex.reconstruction import Observation, disagreement, missing_sides, observation_of

_LEAST_VIEWS = 2


@dataclass(frozen=True, eq=False)
class CaptureViews:
    """Fitted views, views that are only scored, and the source of each silhouette (mask, alpha, plain background)."""

    training: tuple[Observation, ...]
    held_out: tuple[Observation, ...]
    silhouettes: tuple[str, ...]


def capture_views(capture: Capture, held_out: Sequence[str] = (), *, least: int = _LEAST_VIEWS) -> CaptureViews:
    """Frame 0 of every camera with the object's silhouette: its mask, else its alpha, else the difference from a plain
    background.

    Args:
        held_out: names of cameras that are only scored.
        least: least number of fitted views; one is enough if a mesh gives the shape.

    Raises:
        InputError: no cameras, an unknown name, too few views to fit, a camera without any silhouette.
    """
    if not capture.cameras:
        raise InputError(f"{capture.folder}: capture.json names no cameras; a reconstruction needs several with poses")
    for name in held_out:
        capture.camera(name)
    training = len(capture.cameras) - len(set(held_out))
    if training < least:
        raise InputError(
            f"{capture.folder}: {training} view(s) to fit; one view says nothing of depth: expected at least "
            f"{least}, better 12 from all sides{sides_in_words(capture.cameras)}"
        )
    found = [_observation(capture, camera.name) for camera in capture.cameras]
    fitted = tuple(seen for seen, _ in found if seen.camera.name not in held_out)
    only_scored = tuple(seen for seen, _ in found if seen.camera.name in held_out)
    return CaptureViews(fitted, only_scored, tuple(sorted({source for _, source in found})))


def sides_in_words(cameras: Sequence[Camera]) -> str:
    """The sides of a body that cameras do not see which look at it along their axes, as the end of a sentence."""
    missing = missing_sides(np.array([camera.rotation[:, 2] for camera in cameras]).reshape(-1, 3))
    return f"; {missing}" if missing else ""


def warnings_on_views(views: Sequence[Observation]) -> tuple[str, ...]:
    """What a user should know of silhouettes that contradict each other, or that the border of a picture cuts."""
    found = disagreement(views)
    warnings = [f"{found[0].upper()}{found[1:]}. Check its pose and its mask."] if found else []
    for seen in views:
        inside = seen.coverage > 0.5
        if inside[[0, -1]].any() or inside[:, [0, -1]].any():
            warnings.append(
                f"Camera {seen.camera.name}: the object leaves the picture in frame 0; its silhouette is cut there."
            )
    return tuple(warnings)


def _observation(capture: Capture, name: str) -> tuple[Observation, str]:
    """Frame 0 of a camera, and the source of its silhouette."""
    camera, (frame, alpha) = capture.camera(name), capture.first_frame(name)
    mask = capture.first_mask(name)
    if mask is not None:
        return observation_of(camera, frame, mask), "mask"
    if alpha is not None:
        return observation_of(camera, frame, alpha), "alpha"
    from models import plain_background_masks

    masks = plain_background_masks(frame[None])
    if masks is None or not np.any(masks):
        raise InputError(
            f"camera {name!r}: no {name}_mask.mp4 or .png, no alpha channel, and its background is not plain, so the "
            "object cannot be told from it; add a mask (physconvex masks finds those of videos) or images with alpha"
        )
    return observation_of(camera, frame, masks[0]), "plain background"
