"""Follows material points in a video: corners of the first image, by pyramidal Lucas–Kanade flow.

First pass: from image to image, with a forward–backward check (Kalal et al. 2010). It drifts. Second pass, with a
fitted model: the model warps the first image to frame t, and the remaining flow between the warped image and frame t is
measured. Errors do not accumulate, and the patch rotates and deforms with the body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from physconvex.errors import InputError
from physconvex.identify.visible_points import Hits, cast_camera_rays, cast_rays, unit_normals
from physconvex.io import Camera


@dataclass(frozen=True)
class FollowOptions:
    """Settings.

    Attributes:
        count: most points per camera.
        window: side of the patch [pixels], odd.
        levels: of the pyramid beyond the image itself.
        round_trip: largest distance between a point and its image there and back [pixels].
        sigma: stated deviation of a pixel coordinate [pixels].
        grazing: least sine of the angle between surface and ray at which a point is followed.
    """

    count: int = 120
    window: int = 11
    levels: int = 3
    round_trip: float = 0.5
    sigma: float = 0.3
    grazing: float = 0.3


@dataclass(frozen=True, eq=False)
class Seeds:
    """Points of the first image: pixel coordinates [P, 2] and rest positions [P, 3] m."""

    pixels: Float[np.ndarray, "P 2"]
    points: Float[np.ndarray, "P 3"]


def seed_points(
    camera: Camera,
    image: UInt8[np.ndarray, "H W 3"],
    vertices: Float[np.ndarray, "V 3"],
    triangles: Int[np.ndarray, "F 3"],
    options: FollowOptions | None = None,
    *,
    mask: Bool[np.ndarray, "H W"] | None = None,
) -> Seeds:
    """Corners (Shi & Tomasi 1994) of the object in the first image, and their points on its surface.

    Args:
        camera: of the image.
        image: frame 0, which shows the rest state.
        vertices, triangles: the surface at rest [m].
        options: settings.
        mask: where the object is seen; the surface's own outline unless given.

    Raises:
        InputError: the camera sees no corner of the object.
    """
    options = options or FollowOptions()
    hits = cast_camera_rays(camera, vertices, triangles)
    inside = hits.faces >= 0
    if mask is not None:
        inside &= mask
    inner = cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=1 + options.window // 4)
    area = int(inner.sum())
    spacing = max(2.0, 0.7 * float(np.sqrt(area / options.count)))
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    corners = None
    if area:
        corners = cv2.goodFeaturesToTrack(grey, options.count, 0.01, spacing, mask=inner, blockSize=5)
    if corners is None:
        raise InputError(
            f"camera {camera.name!r}: no point of the object can be followed; expected an object with texture where "
            "the mesh and the camera have it at t = 0. Check the camera's pose, or give marker tracks"
        )
    pixels = corners.reshape(-1, 2).astype(np.float64) + 0.5  # OpenCV counts pixel centres
    origin, directions = camera.rays(pixels)
    struck = cast_rays(origin, directions, vertices, triangles)
    normals = unit_normals(vertices, triangles[np.maximum(struck.faces, 0)])
    kept = (struck.faces >= 0) & (np.abs((normals * directions).sum(-1)) > options.grazing)
    return Seeds(pixels[kept], struck.on(vertices, triangles)[kept])


def follow(
    frames: UInt8[np.ndarray, "T H W 3"], pixels: Float[np.ndarray, "P 2"], options: FollowOptions | None = None
) -> Float[np.ndarray, "T P 2"]:
    """Pixel coordinates of points of the first image in all images; NaN from the frame in which they are lost."""
    options = options or FollowOptions()
    grey = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in frames]
    out = np.full((len(frames), len(pixels), 2), np.nan)
    out[0] = pixels
    for t in range(1, len(frames)):
        alive = np.flatnonzero(np.isfinite(out[t - 1]).all(1))
        if not len(alive):
            break
        moved, good = _flow(grey[t - 1], grey[t], out[t - 1, alive], options)
        out[t, alive[good]] = moved[good]
    return out


def _flow(
    before: np.ndarray, after: np.ndarray, pixels: np.ndarray, options: FollowOptions
) -> tuple[np.ndarray, np.ndarray]:
    """New positions of points, and whether the backward flow returns to the old ones."""
    start = (pixels - 0.5).astype(np.float32)[:, None]
    window = (options.window, options.window)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    settings: dict[str, Any] = {"winSize": window, "maxLevel": options.levels, "criteria": criteria}
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, after, start, start.copy(), **settings)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(after, before, there, start.copy(), **settings)
    good = (found.ravel() == 1) & (returned.ravel() == 1)
    good &= np.linalg.norm((back - start).reshape(-1, 2), axis=1) < options.round_trip
    moved = there.reshape(-1, 2).astype(np.float64) + 0.5
    height, width = after.shape
    good &= ((moved > 1) & (moved < [width - 1, height - 1])).all(1)
    return moved, good


def appearance_map(
    camera: Camera, rest: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"], hits: Hits, first: Hits
) -> tuple[np.ndarray, Bool[np.ndarray, "H W"]]:
    """Place in the first image of each pixel of a later one, by the model.

    Args:
        camera: of both images.
        rest: vertices in the first image [m].
        triangles: of the surface.
        hits: surface points of the later image's pixels.
        first: surface points of the first image's pixels.

    Returns:
        Map for `cv2.remap` [H, W, 2] float32, and where it is valid: the point is visible in the first image.
    """
    points = hits.on(rest, triangles)
    pixels, depth = camera.project(np.nan_to_num(points))
    shown = (first.on(rest, triangles) - camera.position) @ -camera.rotation[:, 2]
    inside = (hits.faces >= 0) & (depth > 0) & np.isfinite(pixels).all(-1)
    columns = np.clip(np.nan_to_num(pixels[..., 0]), 0, camera.w - 1).astype(int)
    rows = np.clip(np.nan_to_num(pixels[..., 1]), 0, camera.h - 1).astype(int)
    near = np.abs(shown[rows, columns] - depth) < 0.02 * float(np.ptp(rest, axis=0).max())
    known = inside & near
    return (np.nan_to_num(pixels) - 0.5).astype(np.float32), known


def follow_from_model(
    frames: UInt8[np.ndarray, "T H W 3"],
    camera: Camera,
    *,
    moved: Float[np.ndarray, "T V 3"],
    triangles: Int[np.ndarray, "F 3"],
    predicted: Float[np.ndarray, "T P 3"],
    options: FollowOptions | None = None,
) -> Float[np.ndarray, "T P 2"]:
    """Pixel coordinates of points, measured around the model's prediction.

    Args:
        frames: the images.
        camera: of the images.
        moved: vertices of the surface, moved by the model [m]; frame 0 is the rest state.
        triangles: of the surface.
        predicted: the points, moved by the model [m].
        options: settings.
    """
    options = options or FollowOptions()
    near = replace(options, levels=min(options.levels, 1))  # the model's error is a few pixels at most
    first = cast_camera_rays(camera, moved[0], triangles)
    origin = frames[0].astype(np.float32)
    out = np.full((len(frames), predicted.shape[1], 2), np.nan)
    out[0] = camera.project(predicted[0])[0]
    for t in range(1, len(frames)):
        hits = cast_camera_rays(camera, moved[t], triangles)
        source, known = appearance_map(camera, moved[0], triangles, hits, first)
        if not known.any():
            continue
        picture = cv2.remap(origin, source[..., 0], source[..., 1], cv2.INTER_CUBIC)
        # elsewhere the image itself, so that the coarse level of the pyramid has the same background
        picture = np.where(known[..., None], picture.clip(0, 255), frames[t]).astype(np.uint8)
        inner = cv2.erode(known.astype(np.uint8), np.ones((options.window, options.window), np.uint8)) > 0
        pixels, depth = camera.project(predicted[t])
        usable = np.flatnonzero(_at(inner, pixels) & (depth > 0))
        if not len(usable):
            continue
        before, after = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (picture, frames[t]))
        found, good = _flow(before, after, pixels[usable], near)
        out[t, usable[good]] = found[good]
    return out


def _at(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Values of an image at pixel coordinates; false outside."""
    height, width = image.shape
    inside = np.isfinite(pixels).all(1) & (np.nan_to_num(pixels) >= 0).all(1)
    inside &= (np.nan_to_num(pixels) < [width, height]).all(1)
    columns, rows = np.where(inside[:, None], np.nan_to_num(pixels), 0).astype(int).T
    return inside & image[rows, columns]
