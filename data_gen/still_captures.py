"""Captures of objects at rest: images with alpha from all sides, and the rest geometry."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, UInt8
from PIL import Image

from data_gen.objects.library import ObjectMesh
from data_gen.render import Renderer
from data_gen.surface import Backdrop, DrawnSurface, Lighting
from physconvex import InputError
from physconvex.io import Camera, look_at

KEYED = Lighting(direction=(0.4, -0.5, 0.768))
FLAT = Lighting(direction=(0.0, 0.0, 1.0), key=0.0, fill=0.0, ambient=1.0, specular=0.0, bounce=0.0)
FIELD_OF_VIEW = 0.5  # [rad]
SPACE = 1.08  # around the object
COPIES = 2  # of each image, since a sequence has at least two


@dataclass(frozen=True)
class StillViews:
    """Positions of cameras: equally spaced in azimuth, elevations in turn.

    Attributes:
        count: number of cameras.
        elevations_deg: of the first, the second, … and again.
        phase: offset of the azimuths, as a share of the spacing.
        name: the cameras are name0, name1, …
    """

    count: int
    elevations_deg: tuple[float, ...]
    phase: float = 0.0
    name: str = "camera"


def still_cameras(vertices: Float[np.ndarray, "V 3"], views: StillViews, size: int) -> list[Camera]:
    """Cameras of `size`² pixels that an object [m] just fits into."""
    centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    distance = SPACE * float(np.linalg.norm(vertices - centre, axis=1).max()) / np.sin(FIELD_OF_VIEW / 2)
    cameras = []
    for k in range(views.count):
        azimuth = 2 * np.pi * (k + views.phase) / views.count
        elevation = np.deg2rad(views.elevations_deg[k % len(views.elevations_deg)])
        way = [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
        eye, name = centre + distance * np.array(way), f"{views.name}{k}"
        cameras.append(look_at(eye, centre, width=size, height=size, vertical_field_of_view=FIELD_OF_VIEW, name=name))
    return cameras


def rendered_frames(
    surface: DrawnSurface, camera: Camera, lighting: Lighting, positions: Iterable[Float[np.ndarray, "P 3"]]
) -> list[UInt8[np.ndarray, "h w 4"]]:
    """The object alone with its vertices at each of the positions [m], colours not multiplied by alpha."""
    renderer = Renderer(camera.w, camera.h, supersampling=2)
    white = np.full((2, 2, 3), 255, np.uint8)
    frames = []
    try:
        renderer.set_surface(surface)
        renderer.set_view(camera, lighting, Backdrop(white, white))
        for places in positions:
            rgba = renderer.object_alone(np.asarray(places, dtype=np.float64))
            alpha = rgba[..., 3:]
            colour = rgba[..., :3] / np.maximum(alpha, 1e-6)
            straight = np.concatenate([np.where(alpha > 0, colour, 1.0), alpha], axis=2)
            frames.append((255 * straight.clip(0, 1)).round().astype(np.uint8))
    finally:
        renderer.close()
    return frames


def write_still_capture(
    folder: Path,
    body: ObjectMesh,
    views: Sequence[StillViews],
    *,
    size: int,
    lighting: Lighting = KEYED,
    cameras: Sequence[Camera] = (),
) -> None:
    """Write a capture folder of a coloured object: `<camera>/000000.png`, capture.json, mesh.obj.

    The views are those of `views` about the object, and of further `cameras`.

    Raises:
        InputError: the folder exists, or the object has no colours.
    """
    if folder.exists():
        raise InputError(f"{folder}: exists; choose another folder or remove it first")
    surface = body.drawn()
    cameras = [*cameras, *(camera for group in views for camera in still_cameras(body.vertices, group, size))]
    partial = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        for camera in cameras:
            (partial / camera.name).mkdir()
            (rgba,) = rendered_frames(surface, camera, lighting, [body.vertices])
            for copy in range(COPIES):
                Image.fromarray(rgba).save(partial / camera.name / f"{copy:06d}.png")
        content = {"fps": 24.0, "frames": COPIES, "cameras": [camera.to_json() for camera in cameras]}
        (partial / "capture.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        trimesh.Trimesh(body.vertices, body.faces, process=False).export(partial / "mesh.obj")
        os.rename(partial, folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
