"""Write a capture folder, whole or not at all."""

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import trimesh
from pydantic import JsonValue

from physconvex.errors import InputError
from physconvex.io.capture.folder import Capture
from physconvex.io.capture.metadata import CAPTURE_FILE
from physconvex.io.capture.parts import Boundary, Tracks
from physconvex.io.video.writing import write_video
from physconvex.mesh import TetMesh


def save_capture(
    capture: Capture,
    *,
    videos: Mapping[str, np.ndarray] | None = None,
    masks: Mapping[str, np.ndarray] | None = None,
    mesh: trimesh.Trimesh | None = None,
    tets: TetMesh | None = None,
    tracks: Tracks | None = None,
    boundary: Boundary | None = None,
    truth: Mapping[str, object] | None = None,
    crf: int = 18,
) -> None:
    """Write `capture` to its folder, which must not exist; an interruption leaves no partial folder of that name.

    Args:
        capture: metadata; `capture.folder` is the destination.
        videos: frames by camera name, uint8 [T, H, W, 3], written as H.264 with quality `crf`.
        masks: the object's masks, by camera name, bool [T, H, W], written losslessly.
        mesh: rest geometry, written as OBJ with its texture if it has one.
        tets: tetrahedra of the rest geometry.
        tracks: marker tracks.
        boundary: the held part.
        truth: written to `truth.json`, which only evaluations read.

    Raises:
        InputError: the folder exists; a video of an unknown camera or of another size or length.
    """
    if capture.folder.exists():
        raise InputError(f"{capture.folder}: exists; choose another folder or remove it first")
    _check_pictures(capture, videos or {}, masks or {})
    partial = capture.folder.with_name(f".{capture.folder.name}.{os.getpid()}.part")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        _write_json(partial / CAPTURE_FILE, _metadata(capture))
        _write_arrays(partial, tets, tracks, boundary)
        for name, frames in (videos or {}).items():
            write_video(partial / f"{name}.mp4", frames, fps=capture.fps, crf=crf)
        for name, mask in (masks or {}).items():
            grey = np.where(mask[..., None], np.uint8(255), np.uint8(0))
            write_video(partial / f"{name}_mask.mp4", np.repeat(grey, 3, axis=-1), fps=capture.fps, crf=0)
        if mesh is not None:
            mesh.export(partial / "mesh.obj")
        if truth is not None:
            _write_json(partial / "truth.json", truth)
        os.rename(partial, capture.folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _check_pictures(capture: Capture, videos: Mapping[str, np.ndarray], masks: Mapping[str, np.ndarray]) -> None:
    for kind, pictures in (("videos", videos), ("masks", masks)):
        for name, frames in pictures.items():
            camera = capture.camera(name)
            expected = (capture.frames, camera.h, camera.w)
            if frames.shape[:3] != expected:
                raise InputError(f"{kind}[{name!r}]: got shape {frames.shape}, expected {expected} (frames, h, w)")
    for name, mask in masks.items():
        if mask.dtype != bool:
            raise InputError(f"masks[{name!r}]: got {mask.dtype}; expected bool, true where the object is seen")


def _metadata(capture: Capture) -> dict[str, JsonValue]:
    content: dict[str, JsonValue] = {
        "fps": capture.fps,
        "frames": capture.frames,
        "observed_frames": capture.observed_frames,
        "gravity": capture.gravity.tolist(),
        "density": capture.density,
    }
    if capture.floor is not None:
        floor = capture.floor
        point, normal = np.asarray(floor.point).tolist(), np.asarray(floor.normal).tolist()
        known = {} if floor.friction is None else {"friction": floor.friction}
        content["floor"] = {"point": point, "normal": normal, **known}
    for name in ("initial_velocity", "initial_angular_velocity"):
        vector = getattr(capture, name)
        if vector is not None:
            content[name] = np.asarray(vector).tolist()
    return content | {"cameras": [camera.to_json() for camera in capture.cameras]}


def _write_json(path: Path, content: Mapping[str, object]) -> None:
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _write_arrays(folder: Path, tets: TetMesh | None, tracks: Tracks | None, boundary: Boundary | None) -> None:
    if tets is not None:
        np.savez(folder / "tets.npz", vertices=tets.vertices, tets=tets.tets)
    if tracks is not None:
        np.savez(folder / "tracks.npz", rest=tracks.rest, positions=tracks.positions, sigma=tracks.sigma)
    if boundary is not None:
        parts = {name: value for name, value in vars(boundary).items() if value is not None}
        np.savez(folder / "boundary.npz", **parts)
