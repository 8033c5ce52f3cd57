"""Pictures of a fit: a plot of estimates and search, and a video of observation, model and difference."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np

from inference.refinement.result import Refinement
from physconvex.identify import appearance_map, cast_camera_rays, shaded
from physconvex.io import Camera, Capture, look_at, write_video

_SHOWN = 6  # markers in a plot
_SIZE = 320  # of a view of markers [pixels]
_GREY = 160
_SEEN, _MODEL = (200, 40, 40), (40, 70, 200)


def write_side_by_side(found: Refinement, capture: Capture, path: Path) -> None:
    """Write observed | model | difference of the first camera; without one, markers over the model's surface."""
    of_frames = _video_panels if capture.filmed else _outline_panels if capture.recorded else _marker_panels
    frames = (_labelled(panels, frame, found) for frame, panels in enumerate(of_frames(found, capture)))
    write_video(path, frames, fps=min(capture.fps, 24.0))


def _video_panels(found: Refinement, capture: Capture) -> Iterator[Sequence[np.ndarray]]:
    camera = capture.filmed[0]
    seen = capture.video(camera.name).frames
    first, motion = seen[0].astype(np.float32), found.motion
    rest = cast_camera_rays(camera, motion.vertices[0], motion.faces)
    for frame, image in enumerate(seen):
        if found.appearance is None:
            hit = cast_camera_rays(camera, motion.vertices[frame], motion.faces)
            source, known = appearance_map(camera, motion.vertices[0], motion.faces, hit, rest)
            warped = cv2.remap(first, source[..., 0], source[..., 1], cv2.INTER_LINEAR)
            grey = shaded(camera, motion.vertices[frame], motion.faces, hit)[..., None].repeat(3, -1)
            inside = hit.faces >= 0
            model = np.where(inside[..., None], np.where(known[..., None], warped, grey), 255.0)
        else:
            model, inside = found.appearance.image(frame, camera)
        difference = np.abs(model - image.astype(np.float64)) * inside[..., None]
        yield image, model.clip(0, 255), 255 - difference.clip(0, 255)


def _outline_panels(found: Refinement, capture: Capture) -> Iterator[Sequence[np.ndarray]]:
    """Images of a camera without a video: its masks and the model's, grey on white."""
    camera, motion = capture.recorded[0], found.motion
    masks = capture.mask(camera.name)
    assert masks is not None
    for frame, mask in enumerate(masks):
        inside = cast_camera_rays(camera, motion.vertices[frame], motion.faces).faces >= 0
        yield [np.where(shape, _GREY, 255)[..., None].repeat(3, -1) for shape in (mask, inside, mask != inside)]


def _marker_panels(found: Refinement, capture: Capture) -> Iterator[Sequence[np.ndarray]]:
    tracks, motion = capture.tracks(), found.motion
    camera = _outside(motion.vertices)
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
        yield panels


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


def draw_fit(found: Refinement, capture: Capture, to: Path | BinaryIO) -> None:
    """One picture (PNG) of a fit: markers seen and modelled, the search, the estimates."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7), layout="constrained")
    axes = figure.subplots(2, 2)
    _draw_heights(axes[0, 0], found, capture)
    _draw_distance(axes[0, 1], found, capture)
    _draw_history(axes[1, 0], found)
    _draw_estimates(axes[1, 1], found)
    figure.savefig(to, dpi=110, format="png")


def _draw_heights(axis, found: Refinement, capture: Capture) -> None:  # type: ignore[no-untyped-def]
    tracks, motion = capture.tracks(), found.motion
    if tracks is None:
        lowest, middle = motion.vertices[..., 2].min(1), motion.vertices[..., 2].mean(1)
        axis.plot(motion.times, 1e3 * middle, label="mean of the surface")
        axis.plot(motion.times, 1e3 * lowest, label="lowest point")
        axis.legend(fontsize=8)
    else:
        chosen = np.linspace(0, len(tracks.rest) - 1, min(_SHOWN, len(tracks.rest))).astype(int)
        for number, p in enumerate(chosen):
            axis.plot(motion.times, 1e3 * motion.markers[:, p, 2], color=f"C{number}", lw=1)
            axis.plot(motion.times, 1e3 * tracks.positions[:, p, 2], "o", color=f"C{number}", ms=3)
    axis.axvspan((found.observed_frames - 0.5) / capture.fps, motion.times[-1], color="0.92")
    axis.set(xlabel="time [s]", ylabel="height [mm]", title="model (lines), seen (dots); grey: not fitted")


def _draw_distance(axis, found: Refinement, capture: Capture) -> None:  # type: ignore[no-untyped-def]
    tracks = capture.tracks()
    if tracks is None:
        axis.axis("off")
        lines = [f"{source}: rms {value:.2f} σ" for source, value in found.residual_rms.items()]
        axis.text(0.0, 0.95, "\n".join(lines), va="top", fontsize=9, transform=axis.transAxes)
        return
    distance = np.linalg.norm(found.motion.markers - tracks.positions, axis=-1)
    seen = np.isfinite(distance).any(1)
    rms = np.sqrt(np.nanmean(distance[seen] ** 2, axis=1))
    axis.plot(found.motion.times[seen], 1e3 * rms, "k-o", ms=3, label="rms distance")
    axis.axhline(1e3 * float(np.sqrt(3) * np.median(tracks.sigma)), color="C3", lw=1, label="stated noise")
    axis.axvspan((found.observed_frames - 0.5) / capture.fps, found.motion.times[-1], color="0.92")
    axis.set(xlabel="time [s]", ylabel="distance [mm]", title="markers, seen less model")
    axis.legend(fontsize=8)


def _draw_history(axis, found: Refinement) -> None:  # type: ignore[no-untyped-def]
    axis.semilogy([i.misfit for i in found.history], "k-o", ms=3, label="last search")
    runs = [run.misfit for run in found.full_runs if np.isfinite(run.misfit)]
    if runs:
        axis.semilogy(runs, "C1-s", ms=4, label="full model")
    axis.set(xlabel="step", ylabel="misfit", title="search")
    axis.legend(fontsize=8)


def _draw_estimates(axis, found: Refinement) -> None:  # type: ignore[no-untyped-def]
    axis.axis("off")
    lines = [f"E = {found.youngs_modulus:.4g} Pa", f"ν = {found.poisson_ratio:.4f}", ""]
    for e in found.estimates:
        lines.append(f"{e.name} = {e.value:.5g}   90 %: {e.interval_in_words}")
    lines += ["", f"χ² per degree of freedom {found.reduced_chi_square:.3g}", *found.identifiability.sentences]
    axis.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=8, transform=axis.transAxes, wrap=True)
