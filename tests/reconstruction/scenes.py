"""A striped ball seen from all round, small enough for tests."""

from __future__ import annotations

import math

import numpy as np
import torch
import trimesh

from physconvex.convex import ConvexField, coefficients_of_colour
from physconvex.io import Camera, look_at
from physconvex.reconstruction import Observation, observation_of
from physconvex.render import render

RADIUS = 0.05  # [m]


def ball_mesh(subdivisions: int = 3) -> trimesh.Trimesh:
    """A ball of 5 cm."""
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=RADIUS)


def striped_ball() -> ConvexField:
    """1,280 prisms under the ball's surface in two colours, sharp and opaque."""
    mesh = ball_mesh()
    points = np.concatenate([mesh.triangles, 0.8 * mesh.triangles], axis=1) * 1.005
    stripes = np.sin(120 * mesh.triangles_center[:, 2]) > 0
    colours = torch.as_tensor(np.where(stripes[:, None], [0.9, 0.5, 0.2], [0.2, 0.4, 0.7]), dtype=torch.float32)
    ones = torch.ones(len(points))
    return ConvexField(
        torch.as_tensor(points, dtype=torch.float32), 4e4 * ones, ones, ones, coefficients_of_colour(colours)
    )


def ring(count: int, *, size: int = 48, phase: float = 0.0) -> list[Camera]:
    """Cameras around the ball, alternately above and below."""
    found = []
    for k in range(count):
        angle, up = 2 * math.pi * (k + phase) / count, 0.6 * (-1) ** k
        eye = 0.4 * np.array([math.cos(angle) * math.cos(up), math.sin(angle) * math.cos(up), math.sin(up)])
        found.append(look_at(eye, (0, 0, 0), width=size, height=size, vertical_field_of_view=0.42, name=f"view{k}"))
    return found


def pictures(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Colours (not multiplied by alpha) and alpha of the ball, bytes."""
    image = render(striped_ball(), camera, background=torch.zeros(3))
    colour = image.colour / image.alpha.clamp(min=1e-6)[..., None]
    return tuple((255 * part.clamp(0, 1)).round().byte().numpy() for part in (colour, image.alpha))


def views(count: int, *, size: int = 48, phase: float = 0.0) -> list[Observation]:
    """Observations of the ball."""
    return [observation_of(camera, *pictures(camera)) for camera in ring(count, size=size, phase=phase)]
