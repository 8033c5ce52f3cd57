"""Observations of a diagnosis: marker tracks, or points tracked in the video of one camera, in all frames."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from physconvex.errors import InputError
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.thresholds import BASE_FIT
from physconvex.identify import MarkerObservations, PixelObservations, Twin, follow, marker_observations, seed_points
from physconvex.io import Camera, Capture
from physconvex.mesh import TetMesh

Seen: TypeAlias = MarkerObservations | PixelObservations


def observations_of(capture: Capture, twin: Twin) -> Seen:
    """Marker tracks if there are some, else points of the first camera's video.

    Raises:
        InputError: there is nothing to compare.
    """
    if capture.tracks() is not None:
        seen = marker_observations(capture, frames=capture.frames)
        _check_on_body(capture, seen.points, twin.mesh)
        return seen
    if not capture.recorded:
        raise InputError(
            f"{capture.folder}: no tracks.npz and no cameras; expected marker tracks (rest, positions, sigma) or a "
            "camera in capture.json with its video"
        )
    return followed(capture, capture.recorded[0], twin)


def followed(capture: Capture, camera: Camera, twin: Twin) -> PixelObservations:
    """Points of the surface tracked in the video of a camera.

    Raises:
        InputError: no video, or too few trackable points.
    """
    frames = capture.video(camera.name).frames[: capture.frames]
    masks = capture.mask(camera.name)
    vertices, triangles = twin.surface
    seeds = seed_points(camera, frames[0], vertices, triangles, mask=None if masks is None else masks[0])
    if len(seeds.points) < BASE_FIT.fewest_points:
        raise InputError(
            f"{capture.folder}: camera {camera.name!r}: {len(seeds.points)} points to follow in its first image; "
            f"expected at least {BASE_FIT.fewest_points}: a textured body, sharp and well lit"
        )
    pixels = follow(frames, seeds.pixels)
    return PixelObservations(camera, seeds.points, pixels, np.full(pixels.shape[:2], BASE_FIT.pixel_error))


def _check_on_body(capture: Capture, points: Float[np.ndarray, "P 3"], mesh: TetMesh) -> None:
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    away = np.linalg.norm(points - np.clip(points, low, high), axis=1)
    worst = int(away.argmax())
    if away[worst] > BASE_FIT.off_body * mesh.size:
        raise InputError(
            f"{capture.folder}: tracks.npz: rest[{worst}] lies {away[worst]:.3g} m outside the box of the body "
            f"({mesh.size:.3g} m long); expected rest positions on the body, in the frame of the geometry at t = 0, in "
            "metres"
        )


def with_honest_noise(seen: Seen) -> Seen:
    """Noise, at least as large as the deviation of markers from rest in frame 0, without rotation and strain.

    Frame 0 is the rest state, so this deviation is noise, whatever moves later.
    """
    if not isinstance(seen, MarkerObservations):
        return seen
    known = np.flatnonzero(np.isfinite(seen.positions[0]).all(-1))
    if len(known) < BASE_FIT.points_for_noise:
        return seen
    rest = seen.points[known]
    basis = np.hstack([np.ones((len(rest), 1)), rest - rest.mean(0)])
    missed = seen.positions[0][known] - rest
    left = missed - basis @ np.linalg.lstsq(basis, missed, rcond=None)[0]
    found = float(np.sqrt((left**2).sum() / (3 * (len(rest) - 4))))
    stated = float(np.median(seen.sigma[0][known]))
    if found <= BASE_FIT.noise_in_doubt * stated:
        return seen
    return replace(seen, sigma=seen.sigma * max(found / stated, 1.0))


def starts_elsewhere(seen: Seen) -> bool:
    """Whether markers deviate from their rest positions in the first frame, where only the recording can move them.

    Points of a video come from its first image, so an error of the camera is always possible there.
    """
    if not isinstance(seen, MarkerObservations):
        return True
    first = seen.frames == 0
    residual = seen.residuals(np.repeat(seen.points[None], len(seen.positions), axis=0))[first]
    if not len(residual):
        return True
    count = len(residual) / 3
    shift = residual.reshape(-1, 3).mean(0) * np.sqrt(count)  # unit variance each for noise alone
    whole, shifted = BASE_FIT.starts_off
    return bool((residual**2).mean() > 1 + whole * np.sqrt(2 / len(residual)) or np.abs(shift).max() > shifted)


def lost_points(seen: Seen) -> tuple[str, ...]:
    """A caveat if most of the points of a video are lost during tracking: later frames are not compared."""
    if isinstance(seen, MarkerObservations):
        return ()
    alive = np.isfinite(seen.pixels).all(-1).sum(1)
    gone = np.flatnonzero(alive < max(BASE_FIT.fewest_points, int(BASE_FIT.lasting_points * alive[0])))
    if not len(gone):
        return ()
    return (
        f"Of {alive[0]} points followed in the video, {alive[gone[0]]} are left in frame {gone[0]} of {len(alive)}: "
        "little is known of what came later. A smoother motion, a faster camera or markers would tell more.",
    )


def components(seen: Seen) -> int:
    """Residuals per point and frame."""
    return 3 if isinstance(seen, MarkerObservations) else 2


def widened(seen: Seen, variance: Float[np.ndarray, " N"]) -> Seen:
    """The observations with widened noise, residual by residual (equal for the coordinates of a point)."""
    width = components(seen)
    sigma = np.array(seen.sigma)
    factor = np.sqrt(np.asarray(variance).reshape(-1, width).mean(1))
    sigma[seen.frames[::width], seen.point_indices[::width]] *= factor
    return replace(seen, sigma=sigma)


def in_metres(seen: Seen, motion: PointMotion) -> Float[np.ndarray, " N"]:
    """Length that one standard deviation of each residual stands for [m]; for pixels, at the depth of the point."""
    sigma = np.asarray(seen.sigma)[seen.frames, seen.point_indices]
    if isinstance(seen, MarkerObservations):
        return sigma
    camera = seen.camera
    local = (motion.positions[seen.frames, seen.point_indices] - camera.position) @ camera.rotation
    return np.asarray(sigma * np.abs(local[:, 2]) / np.sqrt(camera.fl_x * camera.fl_y))


def depth_seen(capture: Capture, seen: Seen, frames: Int[np.ndarray, " F"]) -> float:
    """Depth of the second deepest marker in the floor, less noise [m]; 0 without markers or floor.

    The deviation of frame 0 from the rest state counts as a shift of the marker frame.
    """
    if not isinstance(seen, MarkerObservations) or capture.floor is None:
        return 0.0
    normal = np.asarray(capture.floor.normal) / np.linalg.norm(capture.floor.normal)
    first = (seen.positions[0] - seen.points) @ normal
    shift = float(np.nanmean(first)) if np.isfinite(first).any() else 0.0
    height = (seen.positions[frames] - np.asarray(capture.floor.point)) @ normal - shift + 4 * seen.sigma[frames]
    deep = np.sort(-height[np.isfinite(height)])
    return max(float(deep[-2]), 0.0) if len(deep) > 1 else 0.0
