"""A video of what was seen, what the model says, and the difference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from inference.refinement.result import Refinement
from physconvex.identify import cast_camera_rays, shaded
from physconvex.io import Camera, Capture, look_at, write_video

__all__ = ["write_side_by_side"]

_SIZE = 320  # of a view of markers [pixels]
_GREY = 160
_SEEN, _MODEL = (200, 40, 40), (40, 70, 200)


def write_side_by_side(found: Refinement, capture: Capture, path: Path) -> None:
    """Write observed | model | difference of the first camera; markers over the model's surface where there is none."""
    if capture.filmed:
        frames = _video_frames(found, capture)
    else:
        frames = _outline_frames(found, capture) if capture.cameras else _marker_frames(found, capture)
    write_video(path, frames, fps=min(capture.fps, 24.0))


def _video_frames(found: Refinement, capture: Capture) -> UInt8[np.ndarray, "T H W 3"]:
    camera = capture.filmed[0]
    seen = capture.video(camera.name).frames
    first, motion = seen[0].astype(np.float32), found.motion
    from physconvex.identify import appearance_map

    out = []
    rest = cast_camera_rays(camera, motion.vertices[0], motion.faces)
    for frame, image in enumerate(seen):
        hit = cast_camera_rays(camera, motion.vertices[frame], motion.faces)
        source, known = appearance_map(camera, motion.vertices[0], motion.faces, hit, rest)
        warped = cv2.remap(first, source[..., 0], source[..., 1], cv2.INTER_LINEAR)
        grey = shaded(camera, motion.vertices[frame], motion.faces, hit)[..., None].repeat(3, -1)
        model = np.where(known[..., None], warped, grey)
        inside = (hit.faces >= 0).astype(np.float64)
        model = np.where(inside[..., None] > 0, model, 255.0)
        if found.appearance is not None:
            drawn, inside = found.appearance.image(frame, camera)
            model = drawn.astype(np.float64)
        difference = np.abs(model - image) * inside[..., None]
        panels = (image, model.clip(0, 255), 255 - difference.clip(0, 255))
        out.append(_labelled(panels, frame, found))
    return np.stack(out)


def _outline_frames(found: Refinement, capture: Capture) -> UInt8[np.ndarray, "T H W 3"]:
    """Of a camera without images: its masks and the model's, grey before white."""
    camera, motion, out = capture.cameras[0], found.motion, []
    masks = capture.mask(camera.name)
    assert masks is not None
    for frame, mask in enumerate(masks):
        inside = cast_camera_rays(camera, motion.vertices[frame], motion.faces).faces >= 0
        shapes = (mask > 0, inside, (mask > 0) != inside)
        out.append(_labelled([np.where(shape, _GREY, 255)[..., None].repeat(3, -1) for shape in shapes], frame, found))
    return np.stack(out)


def _marker_frames(found: Refinement, capture: Capture) -> UInt8[np.ndarray, "T H W 3"]:
    tracks, motion = capture.tracks(), found.motion
    camera = _outside(motion.vertices)
    out = []
    for frame in range(len(motion.times)):
        hit = cast_camera_rays(camera, motion.vertices[frame], motion.faces)
        grey = shaded(camera, motion.vertices[frame], motion.faces, hit)[..., None].repeat(3, -1)
        model = np.where((hit.faces >= 0)[..., None], grey, 255.0).astype(np.uint8)
        panels = [np.full_like(model, 255), model.copy(), model.copy()]
        if tracks is not None:
            seen, _ = camera.project(tracks.positions[frame])
            said, _ = camera.project(motion.markers[frame])
            _dots(panels[0], seen, _SEEN)
            _dots(panels[1], said, _MODEL)
            _dots(panels[2], said, _MODEL)
            _dots(panels[2], seen, _SEEN)
        out.append(_labelled(panels, frame, found))
    return np.stack(out)


def _outside(vertices: np.ndarray) -> Camera:
    """A camera from the front and a little above that sees all of a motion."""
    low, high = vertices.min((0, 1)), vertices.max((0, 1))
    middle, reach = (low + high) / 2, float(np.linalg.norm(high - low))
    eye = middle + reach * np.array([0.6, -1.6, 0.5])
    return look_at(eye, middle, width=_SIZE, height=_SIZE, vertical_field_of_view=0.62)


def _dots(image: np.ndarray, pixels: np.ndarray, color: tuple[int, int, int]) -> None:
    for x, y in pixels[np.isfinite(pixels).all(1)]:
        cv2.circle(image, (round(float(x)), round(float(y))), 3, color, -1, cv2.LINE_AA)


def _labelled(panels: Sequence[np.ndarray], frame: int, found: Refinement) -> np.ndarray:
    """Three panels side by side, of even width and height, with their names."""
    both = np.concatenate(panels, axis=1).astype(np.uint8)
    height, width = both.shape[:2]
    image = np.ascontiguousarray(both[: height - height % 2, : width - width % 2])
    third = image.shape[1] // 3
    state = "fitted" if frame < found.observed_frames else "predicted"
    for column, text in enumerate(("observed", f"model, {state}", "difference")):
        cv2.putText(image, text, (column * third + 6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return image
