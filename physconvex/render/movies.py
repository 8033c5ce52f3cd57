"""Frames of films: a field seen all round, or a moving one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from physconvex.convex import ConvexField
from physconvex.errors import InputError
from physconvex.io import Camera, look_at
from physconvex.render.rasterize import render

FIELD_OF_VIEW = 0.6  # [rad]
SPACE = 1.1  # around the object


def orbit(
    field: ConvexField, frames: int, *, width: int = 448, height: int = 448, elevation_deg: float = 20.0
) -> list[Camera]:
    """Cameras on a circle about the vertical axis through a field, at a distance at which it fills the image.

    Raises:
        InputError: no frames, or a field without convexes.
    """
    if frames < 1 or not len(field):
        raise InputError(f"orbit: got {frames} frames and {len(field)} convexes; expected at least one of each")
    points = field.points.detach().cpu().double().reshape(-1, 3).numpy()
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = SPACE * float(np.linalg.norm(points - centre, axis=1).max())
    across = FIELD_OF_VIEW if width >= height else 2 * np.arctan(np.tan(FIELD_OF_VIEW / 2) * width / height)
    distance, elevation = radius / np.sin(across / 2), np.deg2rad(elevation_deg)
    cameras = []
    for k in range(frames):
        angle = 2 * np.pi * k / frames - np.pi / 2
        way = [np.cos(angle) * np.cos(elevation), np.sin(angle) * np.cos(elevation), np.sin(elevation)]
        eye = centre + distance * np.array(way)
        cameras.append(
            look_at(eye, centre, width=width, height=height, vertical_field_of_view=FIELD_OF_VIEW, name=f"orbit{k}")
        )
    return cameras


def film(
    fields: Iterable[ConvexField], cameras: Iterable[Camera], *, background: Float[Tensor, " 3"] | None = None
) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    """Pictures of a field per camera, for `physconvex.io.write_video`; repeat either for a still one."""
    for field, camera in zip(fields, cameras, strict=False):
        with torch.no_grad():
            colour = render(field, camera, background=background).colour
        yield (colour.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()
