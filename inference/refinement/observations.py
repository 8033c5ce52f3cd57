"""The observations of a capture: its marker tracks, points followed in its videos, outlines of its masks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from inference.refinement.mask_notes import check_masks
from inference.refinement.options import RefineOptions
from inference.refinement.stages import Arrays, RefinementRun
from physconvex import InputError
from physconvex.identify import (
    FollowOptions,
    Observations,
    OutlineObservations,
    PixelObservations,
    StackedObservations,
    Twin,
    follow,
    follow_from_model,
    marker_observations,
    seed_points,
    start_motion,
)
from physconvex.io import Camera, Capture
from physconvex.mesh import with_fewer_triangles

_UNFOLLOWED = (
    "Camera {}: no point of the object can be followed, so outlines alone are fitted; they do not tell how a surface "
    "turns within them. Paint a texture on, or give marker tracks."
)
_OUTLINED = 8000  # triangles of the surface of outlines: of bodies from pictures, within 0.07 % of the diagonal (rms)


@dataclass(frozen=True, eq=False)
class Observed:
    """The stack of observations, a line on each of its parts, the cameras among them, and notes for the user."""

    observations: StackedObservations
    sources: tuple[str, ...]
    cameras: tuple[Camera, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def follows_points(self) -> bool:
        """Whether it has points followed in videos, which a fitted model can follow better."""
        return any(isinstance(part, PixelObservations) for part in self.observations.parts)

    def rms(self, residuals: np.ndarray) -> dict[str, float]:
        """Root mean square residual by part, in standard deviations of its stated noise."""
        pairs = zip(self.sources, self.observations.residual_slices, strict=True)
        return {source: float(np.sqrt(np.mean(residuals[where] ** 2))) for source, where in pairs}

    def followed_again(self, run: RefinementRun, twin: Twin, move: Callable[[np.ndarray], np.ndarray]) -> Observed:
        """The same, with the video points followed again from a model's positions of them: [P, 3] → [T, P, 3]."""
        arrays = run.stages.run("anchored", lambda: self._follow_again(run.capture, twin, move))
        parts: list[Observations] = []
        sources = list(self.sources)
        for number, part in enumerate(self.observations.parts):
            if isinstance(part, PixelObservations):
                part = replace(part, pixels=arrays[part.camera.name])
                sources[number] = _line(part)
            parts.append(part)
        return replace(self, observations=StackedObservations.of(parts), sources=tuple(sources))

    def _follow_again(self, capture: Capture, twin: Twin, move: Callable[[np.ndarray], np.ndarray]) -> Arrays:
        vertices, triangles = twin.surface
        parts = [part for part in self.observations.parts if isinstance(part, PixelObservations)]
        everything = move(np.concatenate([vertices, *(part.points for part in parts)]))
        moved, places = everything[:, : len(vertices)], len(vertices)
        out = {}
        for part in parts:
            frames = capture.video(part.camera.name).frames[: len(moved)]
            predicted = everything[:, places : places + len(part.points)]
            out[part.camera.name] = follow_from_model(
                frames, part.camera, moved=moved, triangles=triangles, predicted=predicted
            )
            places += len(part.points)
        return out


def observe_capture(run: RefinementRun, twin: Twin) -> tuple[Observed, Twin]:
    """The capture's observations that the options select, and the twin with the initial motion of the tracks.

    Raises:
        InputError: the capture has no such observations.
    """
    capture = run.capture
    tracked, cameras = selected(capture, run.options)
    parts: list[Observations] = []
    sources: list[str] = []
    notes: tuple[str, ...] = ()
    if tracked:
        markers = marker_observations(capture)
        parts.append(markers)
        sources.append(f"{len(markers.points)} markers")
        twin = start_motion(twin, markers)
    if cameras:
        views = [(camera, _observed_mask(capture, camera)) for camera in cameras]
        notes = tuple(note for camera, mask in views if mask is not None for note in check_masks(capture, camera, mask))
        seen = _video_parts(run, twin, views)
        unfollowed = [c for c in cameras if run.options.points and _is_unfollowed(c, capture, seen)]
        notes += tuple(_UNFOLLOWED.format(camera.name) for camera in unfollowed)
        parts.extend(seen)
        sources.extend(_line(part) for part in seen)
    return Observed(StackedObservations.of(parts), tuple(sources), cameras, notes), twin


def selected(capture: Capture, options: RefineOptions) -> tuple[bool, tuple[Camera, ...]]:
    """Whether the tracks of a capture are fitted, and the cameras whose videos are.

    Raises:
        InputError: the capture has no such observations, or no video is fitted and `cameras` are chosen.
    """
    if capture.observed_frames < 2:
        raise InputError(
            f"{capture.folder}: observed_frames is {capture.observed_frames}; expected at least 2, since frame 0 is "
            "the known state at t = 0"
        )
    tracked, filmed = capture.tracks() is not None, bool(capture.recorded)
    wanted = options.observations
    if (wanted in ("tracks", "both") and not tracked) or (wanted in ("video", "both") and not filmed):
        missing = "tracks.npz" if not tracked and wanted != "video" else "cameras in capture.json"
        raise InputError(f"{capture.folder}: observations is {wanted!r}, but there is no {missing}")
    if not tracked and not filmed:
        raise InputError(
            f"{capture.folder}: nothing was observed; expected tracks.npz (rest, positions, sigma) or cameras with "
            "videos in capture.json"
        )
    if tracked and wanted not in ("video", "both"):
        if options.cameras is not None:
            raise InputError(
                f"cameras (--camera): got {', '.join(options.cameras)}, but tracks alone are fitted; leave it out, or "
                "choose the observations video or both"
            )
        return tracked, ()
    names = options.cameras
    cameras = capture.recorded if names is None else tuple(capture.camera(name) for name in names)
    return tracked and wanted != "video", cameras


def _observed_mask(capture: Capture, camera: Camera) -> Bool[np.ndarray, "T H W"] | None:
    mask = capture.mask(camera.name)
    return None if mask is None else mask[: capture.observed_frames]


def _video_parts(
    run: RefinementRun, twin: Twin, views: Sequence[tuple[Camera, Bool[np.ndarray, "T H W"] | None]]
) -> list[Observations]:
    """Points and outlines of each camera; without images or followed points, outlines alone."""
    surface = twin.surface
    arrays = run.stages.run("points", lambda: _followed(run, views, surface))
    outlined = _with_few_triangles(*surface) if run.options.outlines else surface
    parts: list[Observations] = []
    for camera, mask in views:
        if f"{camera.name}/points" in arrays:
            pixels = arrays[f"{camera.name}/pixels"]
            sigma = np.full(pixels.shape[:2], FollowOptions().sigma)
            parts.append(PixelObservations(camera, arrays[f"{camera.name}/points"], pixels, sigma))
        if run.options.outlines and mask is not None:
            parts.append(OutlineObservations.of_masks(camera, mask, *outlined))
    return parts


def _with_few_triangles(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "G 3"]]:
    """A surface with nearly the same outlines, since its vertices are moved at every evaluation."""
    return with_fewer_triangles(vertices, faces, _OUTLINED) if len(faces) > _OUTLINED else (vertices, faces)


def _is_unfollowed(camera: Camera, capture: Capture, parts: Sequence[Observations]) -> bool:
    """Whether a camera has images but no followed point."""
    followed = any(isinstance(part, PixelObservations) and part.camera is camera for part in parts)
    return camera in capture.filmed and not followed


def _followed(
    run: RefinementRun,
    views: Sequence[tuple[Camera, Bool[np.ndarray, "T H W"] | None]],
    surface: tuple[np.ndarray, np.ndarray],
) -> Arrays:
    """Rest positions and pixels of the points that are followed, by camera."""
    out = {}
    for camera, mask in views:
        outlined = run.options.outlines and mask is not None
        if outlined and (camera not in run.capture.filmed or not run.options.points):
            continue
        if not run.options.points:
            raise InputError(
                f"points: are off, and camera {camera.name!r} has no outlines to be fitted instead; expected "
                f"{camera.name}_mask.mp4 and outlines on, or points"
            )
        frames = run.capture.video(camera.name).frames[: run.capture.observed_frames]
        try:
            seeds = seed_points(camera, frames[0], *surface, mask=None if mask is None else mask[0])
        except InputError:
            if not outlined:
                raise
            continue
        out[f"{camera.name}/points"] = seeds.points
        out[f"{camera.name}/pixels"] = follow(frames, seeds.pixels)
    return out


def _line(part: Observations) -> str:
    if isinstance(part, PixelObservations):
        lasting = int(np.isfinite(part.pixels[-1]).all(-1).sum())
        return f"camera {part.camera.name}: {len(part.points)} points, {lasting} of them in the last observed frame"
    assert isinstance(part, OutlineObservations)
    return f"camera {part.camera.name}: {len(part.pixels)} outline points"
