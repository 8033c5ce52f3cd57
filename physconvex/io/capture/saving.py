"""Write a capture folder, whole or not at all."""

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Bool
from PIL import Image
from pydantic import JsonValue

from physconvex.errors import InputError
from physconvex.io.capture.folder import Capture
from physconvex.io.capture.metadata import CAPTURE_FILE
from physconvex.io.capture.parts import Boundary, Tracks
from physconvex.io.video.writing import write_video
from physconvex.io.whole_files import write_json
from physconvex.mesh import TetMesh


def save_capture(
    capture: Capture,
    *,
    videos: Mapping[str, np.ndarray] | None = None,
    stills: Mapping[str, np.ndarray] | None = None,
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
        stills: pictures of frame 0 alone, by camera name, uint8 [H, W, 3], or [H, W, 4] with alpha, written as PNG.
        masks: the object's masks, by camera name, bool [T, H, W], or [H, W] of frame 0 alone, written losslessly.
        mesh: rest geometry, written as OBJ with its texture if it has one.
        tets: tetrahedra of the rest geometry.
        tracks: marker tracks.
        boundary: the held part.
        truth: written to `truth.json`, which only evaluations read.

    Raises:
        InputError: the folder exists; a picture of an unknown camera, of another size or length, or of another type.
    """
    if capture.folder.exists():
        raise InputError(f"{capture.folder}: exists; choose another folder or remove it first")
    videos, stills, masks = videos or {}, stills or {}, masks or {}
    _check_pictures(capture, videos, stills, masks)
    partial = capture.folder.with_name(f".{capture.folder.name}.{os.getpid()}.part")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        write_json(partial / CAPTURE_FILE, _metadata(capture))
        _write_arrays(partial, tets, tracks, boundary)
        for name, frames in videos.items():
            write_video(partial / f"{name}.mp4", frames, fps=capture.fps, crf=crf)
        for name, picture in stills.items():
            Image.fromarray(picture).save(partial / f"{name}.png")
        for name, mask in masks.items():
            write_mask(partial / f"{name}_mask", mask, fps=capture.fps)
        if mesh is not None:
            mesh.export(partial / "mesh.obj")
        if truth is not None:
            write_json(partial / "truth.json", truth)
        os.rename(partial, capture.folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _check_pictures(
    capture: Capture,
    videos: Mapping[str, np.ndarray],
    stills: Mapping[str, np.ndarray],
    masks: Mapping[str, np.ndarray],
) -> None:
    frames, uint8 = (capture.frames,), ("uint8", "uint8")
    for name, video in videos.items():
        _check_picture(f"videos[{name!r}]", video, (*frames, *_size(capture, name), 3), uint8)
    for name, still in stills.items():
        channels = 4 if still.shape[2:] == (4,) else 3
        _check_picture(f"stills[{name!r}]", still, (*_size(capture, name), channels), uint8)
    for name, mask in masks.items():
        kind = ("bool", "bool, true where the object is seen")
        _check_picture(f"masks[{name!r}]", mask, (*(() if mask.ndim == 2 else frames), *_size(capture, name)), kind)


def _size(capture: Capture, camera: str) -> tuple[int, int]:
    found = capture.camera(camera)
    return found.h, found.w


def _check_picture(name: str, picture: np.ndarray, shape: tuple[int, ...], kind: tuple[str, str]) -> None:
    """Shape, and type: its name, and its description."""
    if picture.shape != shape:
        raise InputError(f"{name}: got shape {picture.shape}, expected {shape}")
    if picture.dtype != kind[0]:
        raise InputError(f"{name}: got {picture.dtype}; expected {kind[1]}")


def write_mask(stem: Path, mask: Bool[np.ndarray, "*T H W"], *, fps: float) -> None:
    """White where the object is: a picture STEM.png, or for several frames a lossless video STEM.mp4."""
    grey = np.where(mask, np.uint8(255), np.uint8(0))
    if mask.ndim == 2:
        Image.fromarray(grey).save(stem.with_name(f"{stem.name}.png"))
    else:
        write_video(stem.with_name(f"{stem.name}.mp4"), np.repeat(grey[..., None], 3, axis=-1), fps=fps, crf=0)


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


def _write_arrays(folder: Path, tets: TetMesh | None, tracks: Tracks | None, boundary: Boundary | None) -> None:
    if tets is not None:
        np.savez(folder / "tets.npz", vertices=tets.vertices, tets=tets.tets)
    if tracks is not None:
        np.savez(folder / "tracks.npz", rest=tracks.rest, positions=tracks.positions, sigma=tracks.sigma)
    if boundary is not None:
        parts = {name: value for name, value in vars(boundary).items() if value is not None}
        np.savez(folder / "boundary.npz", **parts)
