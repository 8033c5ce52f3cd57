"""Captures of objects at rest: pictures with alpha from all sides, and the rest geometry."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, UInt8

from data_gen.objects.library import ObjectMesh
from data_gen.render import Renderer
from data_gen.surface import Backdrop, DrawnSurface, Lighting
from physconvex.io import Camera, Capture, look_at, save_capture

KEYED = Lighting(direction=(0.4, -0.5, 0.768))
FLAT = Lighting(direction=(0.0, 0.0, 1.0), key=0.0, fill=0.0, ambient=1.0, specular=0.0, bounce=0.0)
FIELD_OF_VIEW = 0.5  # [rad]
SPACE = 1.08  # around the object


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
    folder: Path, body: ObjectMesh, views: Sequence[StillViews], *, size: int, lighting: Lighting = KEYED
) -> None:
    """Write a capture folder of a coloured object at rest: one picture with alpha of each view, and the mesh.

    Raises:
        InputError: the folder exists, or the object has no colours.
    """
    surface = body.drawn()
    cameras = [camera for group in views for camera in still_cameras(body.vertices, group, size)]
    stills = {camera.name: rendered_frames(surface, camera, lighting, [body.vertices])[0] for camera in cameras}
    capture = Capture(folder, fps=24.0, frames=1, observed_frames=1, cameras=tuple(cameras))
    save_capture(capture, stills=stills, mesh=trimesh.Trimesh(body.vertices, body.faces, process=False))
