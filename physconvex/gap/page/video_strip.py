"""The video next to the models: observed, base model, with the effects, and differences.

A model's picture is the first image, moved with the model's surface. It is empty where that image does not show it.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from physconvex.errors import ConvergenceError
from physconvex.gap.page.findings import GapFindings
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.identify import PixelObservations, appearance_map, cast_camera_rays
from physconvex.io import Camera

Rows = list[tuple[str, list[np.ndarray]]]  # pictures side by side, by name
_COLUMNS = 6
_EMPTY = 235  # grey of empty pixels of a model's picture
_MARGIN = 12  # pixels around the body


def video_strip(report: GapFindings) -> Figure | None:
    """Some frames of the video in columns; None if markers are compared, or a model cannot be run again."""
    seen, base = report.base.observations, report.base
    if not isinstance(seen, PixelObservations):
        return None
    frames = base.capture.video(seen.camera.name).frames[: base.model.frames]
    vertices, triangles = base.model.twin.surface
    first = next(h for h in report.hypotheses if not h.effects)
    models = [("base model", first)]
    if report.best.effects:
        models.append((f"with {report.best.label}", report.best))
    try:
        moved = [(name, _moved(h, vertices)) for name, h in models]
    except ConvergenceError:
        return None
    chosen = np.unique(np.linspace(0, len(frames) - 1, _COLUMNS + 1).round().astype(int)[1:])
    rows = [("observed", [frames[t] for t in chosen])]
    rows += [(name, [_picture(seen.camera, frames[0], x, t, triangles) for t in chosen]) for name, x in moved]
    differences = [(f"observed − {name}", [_difference(frames[t], picture) for t, picture in zip(chosen, shown)])  # noqa: B905
                   for name, shown in rows[1:]]  # fmt: skip
    return _drawn(rows, differences, chosen, base.capture.fps, _window(seen.camera, [x for _, x in moved], frames))


def _moved(hypothesis: Hypothesis, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "T V 3"]:
    """The surface's motion in the model's observation.

    Raises:
        ConvergenceError: the model cannot be run again.
    """
    model = replace(hypothesis.model, points=vertices, correction=None, directions={})
    return model.positions(hypothesis.values)


def _picture(camera: Camera, origin: np.ndarray, moved: np.ndarray, frame: int, triangles: np.ndarray) -> np.ndarray:
    """The first image moved with the model, [H, W, 4]; the last channel marks known pixels."""
    rest = cast_camera_rays(camera, moved[0], triangles)
    hits = cast_camera_rays(camera, moved[frame], triangles)
    source, known = appearance_map(camera, moved[0], triangles, hits, rest)
    picture = cv2.remap(origin, source[..., 0], source[..., 1], cv2.INTER_LINEAR)
    return np.dstack([np.where(known[..., None], picture, _EMPTY), 255 * known]).astype(np.uint8)


def _difference(observed: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """Brightness of the observed image less the model's, −1 to 1; NaN where the model shows nothing."""
    known = picture[..., 3] > 0
    signed = (observed.astype(np.float64).mean(-1) - picture[..., :3].astype(np.float64).mean(-1)) / 255
    return np.where(known, signed, np.nan)


def _window(camera: Camera, moved: list[np.ndarray], frames: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of the picture that contain the body in any frame."""
    pixels = np.concatenate([camera.project(x.reshape(-1, 3))[0] for x in moved])
    pixels = pixels[np.isfinite(pixels).all(1)]
    height, width = frames.shape[1:3]
    low = np.clip(pixels.min(0) - _MARGIN, 0, [width - 2, height - 2]).astype(int)
    high = np.clip(pixels.max(0) + _MARGIN, low + 2, [width, height]).astype(int)
    return slice(low[1], high[1]), slice(low[0], high[0])


def _drawn(
    rows: Rows, differences: Rows, chosen: np.ndarray, fps: float, window: tuple[slice, slice]
) -> Figure:  # fmt: skip
    height, width = rows[0][1][0][window].shape[:2]
    count = len(rows) + len(differences)
    side = 9.5 / len(chosen)
    figure = Figure(figsize=(9.5 + 1.0, count * side * height / width + 0.3), layout="constrained")
    panels = figure.subplots(count, len(chosen), squeeze=False)
    for number, (line, (name, pictures)) in enumerate(zip(panels, [*rows, *differences], strict=True)):
        for axes, picture, frame in zip(line, pictures, chosen, strict=True):
            axes.set_xticks([])
            axes.set_yticks([])
            for spine in axes.spines.values():
                spine.set_visible(False)
            shown = picture[window]
            if picture.ndim == 2:
                axes.set_facecolor("#f2f2f2")
                axes.imshow(shown, cmap="RdBu", vmin=-0.5, vmax=0.5)
            else:
                axes.imshow(shown[..., :3])
            if number == 0:
                axes.set_title(f"frame {frame}, {1e3 * frame / fps:.0f} ms", fontsize=8)
        line[0].set_ylabel(name.replace(" + ", "\n+ ").replace("observed − ", "observed −\n"), fontsize=7)
    return figure
