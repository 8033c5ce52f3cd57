"""Reconstruct the object of a capture at rest as a convex field, with result files."""

from __future__ import annotations

import hashlib
import itertools
import json
import logging
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import numpy as np
import torch
import trimesh
from PIL import Image
from pydantic import JsonValue

import physconvex
from inference.reconstruction_views import CaptureViews, capture_views, warnings_on_views
from inference.settings import ReconstructOptions
from physconvex import InputError
from physconvex.convex import ConvexField, read_ply, write_glb, write_ply
from physconvex.io import Picture, html_summary, load_capture, png_bytes, read_mesh, write_json, write_video
from physconvex.numerics import device_named
from physconvex.reconstruction import (
    FitProgress,
    FitState,
    Hollow,
    Observation,
    ReconstructionConfig,
    SurfaceError,
    ViewScore,
    begin,
    body_surface,
    closed_surface,
    fill_gaps,
    find_hollow,
    fit_field,
    load_fit,
    missing_sides,
    save_fit,
    score_views,
    start_field,
    start_kind,
    surface_error,
    textured,
)
from physconvex.render import film, orbit

_LOG = logging.getLogger("physconvex")

STATE, RESULT = "state.safetensors", "reconstruction.json"
FIELD, HULLS, FILM = "field.ply", "hulls.glb", "turntable.mp4"
BODY, BODY_GLB = "body.ply", "body.glb"
_Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])  # as in glTF
_STORE_EVERY = 20.0  # seconds
_DIFFERENCE_GAIN = 4.0
_FILM_FRAMES, _FILM_RATE = 48, 24.0
_MUCH = 0.2  # of the surface, whose place is not told, of which the user is told; 12 pictures from around leave a tenth


class ScoreTable(TypedDict):
    """Scores of some views."""

    mean: dict[str, float]
    views: list[dict[str, Any]]
    """The fields of `ViewScore`, one entry a view."""


class BodyRecord(TypedDict):
    """The body's surface.

    Volume [m³], longest edge of its bounding box [m], number of pictures, share of the surface that fewer than two of
    them show, time to find it [s].
    """

    volume: float
    size: float
    views: int
    unseen: float
    seconds: float


class ReconstructionRecord(TypedDict):
    """Content of `reconstruction.json`."""

    claim: NotRequired[str]
    """Checksum of everything that the result depends on."""
    version: str
    convexes: int
    points_per_convex: int
    start: str
    silhouettes: list[str]
    seconds: float
    body: BodyRecord | None
    warnings: list[str]
    training: ScoreTable
    held_out: ScoreTable
    config: dict[str, JsonValue]


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A convex field with its quality in the views, and the body's surface.

    Attributes:
        field: the convexes at rest, world frame.
        body: closed surface of the body [m], coloured; None if no point in space projects into all silhouettes.
        error: how far that may be from the body's; None without it.
        warnings: notes for the user: views that contradict each other, sides that none shows.
        training, held_out: scores of the fitted views and of the others.
        start: source of the first convexes: mesh, hull or points.
        silhouettes: source of the object's silhouettes.
        seconds, body_seconds: wall-clock time of the fit, and of the surface [s].
        config: the settings.
        out: folder of the files, or None.
    """

    field: ConvexField
    body: trimesh.Trimesh | None
    training: tuple[ViewScore, ...]
    held_out: tuple[ViewScore, ...]
    start: str
    silhouettes: tuple[str, ...]
    seconds: float
    body_seconds: float
    config: ReconstructionConfig
    out: Path | None = None
    error: SurfaceError | None = None
    warnings: tuple[str, ...] = ()

    def _repr_html_(self) -> str:
        """Scores of the views and a picture of the field, for a notebook."""
        rows = [("convexes", f"{len(self.field)}, from the {self.start}"), ("seconds", f"{self.seconds:.0f}")]
        for name, scores in (("fitted", self.training), ("held out", self.held_out)):
            if scores:
                text = "PSNR {psnr:.2f} dB ({psnr_object:.2f} dB on the object), SSIM {ssim:.4f}"
                rows.append((f"{name} ({len(scores)} views)", text.format(**_table(scores)["mean"])))
        (image,) = film([self.field], orbit(self.field, 1))
        pictures = [Picture(png_bytes(image), "the field from one side")]
        return html_summary("Reconstruction", rows, pictures=pictures)

    def to_json(self) -> ReconstructionRecord:
        """Content of `reconstruction.json`."""
        return {
            "version": physconvex.__version__,
            "convexes": len(self.field),
            "points_per_convex": self.field.points.shape[1],
            "start": self.start,
            "silhouettes": list(self.silhouettes),
            "seconds": self.seconds,
            "body": self._body_record(),
            "warnings": list(self.warnings),
            "training": _table(self.training),
            "held_out": _table(self.held_out),
            "config": self.config.model_dump(mode="json"),
        }

    def _body_record(self) -> BodyRecord | None:
        if self.body is None or self.error is None:
            return None
        return {
            "volume": float(self.body.volume),
            "size": float(self.body.extents.max()),
            "views": len(self.training),
            "unseen": self.error.unseen_share,
            "seconds": self.body_seconds,
        }


def _table(scores: Sequence[ViewScore]) -> ScoreTable:
    """Means over the views, and every view."""
    rows = [asdict(one) for one in scores]
    names = [name for name in ViewScore.__dataclass_fields__ if name != "camera"]
    means = {name: float(np.mean([row[name] for row in rows])) for name in names} if rows else {}
    return {"mean": means, "views": rows}


def reconstruct(
    capture: str | Path,
    *,
    out: str | Path | None = None,
    options: ReconstructOptions | None = None,
    turntable: bool = False,
    redo: bool = False,
    on_step: Callable[[FitProgress], None] | None = None,
) -> Reconstruction:
    """Fit a convex field to the first frames of a capture, and find the body's closed surface.

    With `out` a run can be stopped at any time: the same call continues it, and a finished one is read from its files.
    Writes field.ply, hulls.glb, body.ply, body.glb, reconstruction.json and views/<camera>.png (observed, rendered,
    difference).

    Args:
        capture: folder with capture.json.
        out: folder of the results; nothing is written if not given.
        options: settings.
        turntable: write turntable.mp4 too.
        redo: ignore earlier results in `out`.
        on_step: called after every step.

    Raises:
        InputError: see `capture_views`; a start or a device that is not possible; `out` holds another reconstruction.
    """
    options = ReconstructOptions.or_default(options)
    place, config = device_named(options.device), options.resolved
    folder = None if out is None else Path(out)
    source = load_capture(capture)
    views = capture_views(source, options.held_out)
    given = None if options.points is None else _read_points(options.points)
    claim = _claim(views, config, given)
    if folder is not None:
        finished = _prepared(folder, claim, redo=redo)
        if finished is not None:
            return _with_warnings_told(_read(folder, finished, config, views))
    state = None if folder is None else load_fit(folder / STATE, claim=claim)
    mesh = source.mesh()
    kind = start_kind(config.start, mesh=mesh is not None, points=given is not None)
    _LOG.info("reconstruct: %s from step %d", capture, 0 if state is None else state.step)
    if state is None:
        state = begin(start_field(views.training, config, mesh=mesh, points=given))
    state = _fit_and_store(state.to(place), views, config, folder=folder, claim=claim, on_step=on_step)
    field = state.field().to("cpu")
    clock = time.perf_counter()
    body, error, hollow = _body(field, views)
    body_seconds = time.perf_counter() - clock
    field = _filled(field, state, body or body_surface(kind, views.training, mesh), config)
    inside = _on_contested(error) if hollow is None else _on_hollow(hollow)
    warnings = (*warnings_on_views(views.training), *_on_unseen(body, error, views), *inside)
    trained, tested = (score_views(field.to(place), part) for part in (views.training, views.held_out))
    training, held_out = (tuple(one for one, _ in part) for part in (trained, tested))
    result = Reconstruction(
        field, body, training, held_out, kind, views.silhouettes, state.seconds, body_seconds, config, folder,
        error=error, warnings=warnings,
    )  # fmt: skip
    _LOG.info("reconstruct: %d convexes from the %s in %.0f s", len(field), kind, state.seconds)
    if folder is not None:
        pictures = [image for _, image in (*trained, *tested)]
        _write(result, folder, views, pictures, claim, turntable=turntable, place=place)
    return _with_warnings_told(result)


def _with_warnings_told(found: Reconstruction) -> Reconstruction:
    """It as it is. Its warnings are told each time that it is used."""
    for warning in found.warnings:
        _LOG.warning("reconstruct: %s", warning)
    return found


def _filled(
    field: ConvexField, state: FitState, surface: trimesh.Trimesh | None, config: ReconstructionConfig
) -> ConvexField:
    """The field with the inside of the surface filled by the remaining budget."""
    if surface is None or not config.gap_share:
        return field
    clock = time.perf_counter()
    field = fill_gaps(field, surface, footprint=state.footprint, budget=config.budget)
    state.seconds += time.perf_counter() - clock
    return field


def _body(field: ConvexField, views: CaptureViews) -> tuple[trimesh.Trimesh | None, SurfaceError | None, Hollow | None]:
    """The closed surface, its error and its hollow; none, with a warning, where silhouettes contradict each other."""
    try:
        filled = closed_surface(field, views.training)
    except InputError as reason:
        _LOG.warning("reconstruct: no surface of the body: %s", reason)
        return None, None, None
    error = surface_error(filled, views.training)
    hollow = find_hollow(filled, views.training) if error.contested_share else None
    if hollow is None:
        return filled, error, None
    return hollow.surface, surface_error(hollow.surface, views.training), hollow


def _on_unseen(body: trimesh.Trimesh | None, error: SurfaceError | None, views: CaptureViews) -> list[str]:
    """A warning where few pictures show much of the body, with the sides that no camera sees."""
    if body is None or error is None or error.unseen_share < _MUCH:
        return []
    centre = body.bounds.mean(axis=0)
    missing = missing_sides(np.array([seen.camera.position - centre for seen in views.training]))
    why = missing or "parts of the body are in front of it"
    return [
        f"{100 * error.unseen_share:.0f} % of the surface is shown by fewer than two pictures, which do not tell its "
        f"place: {why}."
    ]


def _on_contested(error: SurfaceError | None) -> list[str]:
    """A warning where the colours of much of the surface differ from picture to picture."""
    if error is None or not error.contested_share:
        return []
    return [
        f"{100 * error.contested_share:.0f} % of the surface has other colours in every picture: it shines, or the "
        "body has a hollow there, which no silhouette shows and the reconstruction fills. Take pictures that look "
        "into it, or give the surface (--body)."
    ]


def _on_hollow(hollow: Hollow) -> list[str]:
    """A warning of a hollow, whose wall is known in part alone."""
    return [
        f"Pictures look into a hollow of {100 * hollow.share:.0f} % of what the silhouettes enclose. Its wall is "
        f"{1000 * hollow.thickness:.2g} mm thick where they show it, and taken to be so everywhere."
    ]


def _fit_and_store(
    state: FitState,
    views: CaptureViews,
    config: ReconstructionConfig,
    *,
    folder: Path | None,
    claim: str,
    on_step: Callable[[FitProgress], None] | None,
) -> FitState:
    """Fit, with the state on disk every now and then."""
    stored = time.monotonic()

    def after(progress: FitProgress, state: FitState) -> None:
        nonlocal stored
        if folder is not None and (progress.step == progress.steps or time.monotonic() - stored > _STORE_EVERY):
            save_fit(state, folder / STATE, claim=claim)
            stored = time.monotonic()
        if on_step is not None:
            on_step(progress)

    return fit_field(state, views.training, config, on_step=after)


def _read_points(path: Path) -> np.ndarray:
    try:
        loaded: Any = trimesh.load(path, process=False)
        return np.asarray(loaded.vertices, dtype=np.float64)
    except Exception as error:  # trimesh's readers raise any exception on broken files
        raise InputError(
            f"points: {path} cannot be read ({type(error).__name__}: {error}); expected PLY or OBJ"
        ) from None


def _claim(views: CaptureViews, config: ReconstructionConfig, points: np.ndarray | None) -> str:
    """Checksum of everything that the result depends on."""
    digest = hashlib.sha256(b"field, surface, hollow and warnings" + config.model_dump_json().encode())
    for part in (views.training, views.held_out):
        digest.update(b"part")
        for seen in part:
            digest.update(json.dumps(seen.camera.to_json()).encode())
            for tensor in (seen.image, seen.coverage):
                digest.update(tensor.numpy().tobytes())
    digest.update(b"" if points is None else points.tobytes())
    return digest.hexdigest()[:32]


def _prepared(folder: Path, claim: str, *, redo: bool) -> ReconstructionRecord | None:
    """Make the folder; returns the same reconstruction if the folder already has it.

    Raises:
        InputError: it holds another one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if redo:
        for name in (STATE, RESULT, FIELD, HULLS, BODY, BODY_GLB, FILM):
            (folder / name).unlink(missing_ok=True)
        shutil.rmtree(folder / "views", ignore_errors=True)
    if not (folder / RESULT).exists():
        return None
    try:
        content: ReconstructionRecord = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{folder / RESULT}: no valid JSON ({error}); remove it or use redo") from None
    if content.get("claim") != claim:
        raise InputError(
            f"{folder}: holds a reconstruction of another capture or with other settings; choose another folder or redo"
        )
    return content


def _read(
    folder: Path, content: ReconstructionRecord, config: ReconstructionConfig, views: CaptureViews
) -> Reconstruction:
    """A finished reconstruction."""
    training, held_out = (
        tuple(ViewScore(**row) for row in content[part]["views"]) for part in ("training", "held_out")
    )
    silhouettes = tuple(content["silhouettes"])
    field = read_ply(folder / FIELD)
    start, seconds, stated = content["start"], content["seconds"], content["body"]
    body = None if stated is None else read_mesh(folder / BODY)
    spent = 0.0 if stated is None else stated["seconds"]
    error = None if body is None else surface_error(body, views.training)
    return Reconstruction(
        field, body, training, held_out, start, silhouettes, seconds, spent, config, folder,
        error=error, warnings=tuple(content["warnings"]),
    )  # fmt: skip


def _write(
    result: Reconstruction,
    folder: Path,
    views: CaptureViews,
    pictures: Sequence[torch.Tensor],
    claim: str,
    *,
    turntable: bool,
    place: torch.device,
) -> None:
    """Write all files; the summary last, since it marks the others as complete."""
    write_ply(result.field, folder / FIELD)
    write_glb(result.field, folder / HULLS)
    if result.body is not None:
        result.body.export(folder / BODY)
        upright = textured(result.body, views.training)
        upright.apply_transform(_Y_UP)
        upright.export(folder / BODY_GLB)
    (folder / "views").mkdir(exist_ok=True)
    for seen, picture in zip((*views.training, *views.held_out), pictures, strict=True):
        _write_comparison(folder / "views" / f"{seen.camera.name}.png", seen, picture)
    if turntable:
        frames = film(itertools.repeat(result.field.to(place)), orbit(result.field, _FILM_FRAMES))
        write_video(folder / FILM, frames, fps=_FILM_RATE)
    write_json(folder / RESULT, {"claim": claim, **result.to_json()}, allow_nan=True)
    (folder / STATE).unlink(missing_ok=True)


def _write_comparison(path: Path, seen: Observation, rendered: torch.Tensor) -> None:
    """Write one PNG: the view, the rendered image [H, W, 3], four times their absolute difference on black."""
    difference = (_DIFFERENCE_GAIN * (rendered - seen.image).abs()).clamp(0, 1)
    row = torch.cat([seen.image, rendered.clamp(0, 1), difference], dim=1)
    Image.fromarray((255 * row.numpy()).round().astype(np.uint8)).save(path)
