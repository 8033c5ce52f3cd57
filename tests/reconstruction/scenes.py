"""A striped ball and a cup, seen from all round, small enough for tests."""

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
WALL = 0.012  # [m]
CELL = 0.0025  # [m], about


def ball_mesh(subdivisions: int = 3) -> trimesh.Trimesh:
    """A ball of 5 cm."""
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=RADIUS)


def striped_ball() -> ConvexField:
    """1,280 prisms under the ball's surface in two colours, sharp and opaque."""
    stripes = np.sin(120 * ball_mesh().triangles_center[:, 2]) > 0
    return _ball(np.where(stripes[:, None], [0.9, 0.5, 0.2], [0.2, 0.4, 0.7]))


def speckled_ball() -> ConvexField:
    """The same in random colours, of which every patch is recognised."""
    return _ball(np.random.default_rng(0).uniform(0.1, 0.9, (len(ball_mesh().faces), 3)))


def _ball(colours: np.ndarray) -> ConvexField:
    mesh = ball_mesh()
    points = np.concatenate([mesh.triangles, 0.8 * mesh.triangles], axis=1) * 1.005
    ones, rgb = torch.ones(len(points)), torch.as_tensor(colours, dtype=torch.float32)
    return ConvexField(
        torch.as_tensor(points, dtype=torch.float32), 4e4 * ones, ones, ones, coefficients_of_colour(rgb)
    )


def upright(radius: float, low: float, high: float) -> trimesh.Trimesh:
    """A cylinder with small triangles."""
    body = trimesh.creation.cylinder(radius=radius, height=high - low, sections=48)
    body.apply_translation([0, 0, 0.5 * (low + high)])
    return body.subdivide_to_size(2 * CELL)


def cup() -> trimesh.Trimesh:
    inside = upright(RADIUS - WALL, WALL - RADIUS, 2 * RADIUS)
    return trimesh.boolean.difference([upright(RADIUS, -RADIUS, RADIUS), inside], engine="manifold")


def painted(body: trimesh.Trimesh) -> ConvexField:
    """Thin prisms under its triangles, in patches of two colours."""
    body = body.subdivide_to_size(2 * CELL)
    points = np.concatenate([body.triangles, body.triangles - 0.2 * WALL * body.face_normals[:, None]], axis=1)
    x, y, z = body.triangles_center.T
    patches = (np.sin(5 * np.arctan2(y, x)) * np.sin(180 * (z + 0.3 * x)) > 0)[:, None]
    colours = np.where(patches, [0.9, 0.5, 0.2], [0.1, 0.3, 0.7])
    ones, rgb = torch.ones(len(points)), torch.as_tensor(colours, dtype=torch.float32)
    return ConvexField(
        torch.as_tensor(points, dtype=torch.float32), 4e4 * ones, ones, ones, coefficients_of_colour(rgb)
    )


def ring(count: int, *, size: int = 48, phase: float = 0.0) -> list[Camera]:
    """Cameras around the ball, alternately above and below."""
    found = []
    for k in range(count):
        angle, up = 2 * math.pi * (k + phase) / count, 0.6 * (-1) ** k
        eye = 0.4 * np.array([math.cos(angle) * math.cos(up), math.sin(angle) * math.cos(up), math.sin(up)])
        found.append(look_at(eye, (0, 0, 0), width=size, height=size, vertical_field_of_view=0.42, name=f"view{k}"))
    return found


def pictures(camera: Camera, field: ConvexField | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Colours (not multiplied by alpha) and alpha of a field, the striped ball by default, bytes."""
    image = render(striped_ball() if field is None else field, camera, background=torch.zeros(3))
    colour = image.colour / image.alpha.clamp(min=1e-6)[..., None]
    return tuple((255 * part.clamp(0, 1)).round().byte().numpy() for part in (colour, image.alpha))


def views(count: int, *, size: int = 48, phase: float = 0.0, field: ConvexField | None = None) -> list[Observation]:
    """Observations of a field, the striped ball by default."""
    return [observation_of(camera, *pictures(camera, field)) for camera in ring(count, size=size, phase=phase)]
