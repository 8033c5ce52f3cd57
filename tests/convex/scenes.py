"""Cameras and hard cases that the tests of rendering share."""

from __future__ import annotations

import torch

from physconvex.convex import ConvexField
from physconvex.io import Camera, look_at
from tests.convex.fields import random_field


def camera(width: int = 24, height: int = 18, *, distance: float = 2.0) -> Camera:
    """A camera before the origin, its principal point off the middle, its pixels not square."""
    view = look_at((0.3, -distance, 0.4), (0, 0, 0), width=width, height=height, vertical_field_of_view=0.7)
    changed = {"fl_x": 1.1 * view.fl_x, "cx": view.cx + 1.3, "cy": view.cy - 0.7}
    return Camera(**({name: getattr(view, name) for name in view.__dataclass_fields__} | changed))


HARD_CASES = ("overlapping", "edge_on", "tiny", "huge", "behind", "near", "flat_points", "opaque", "faint")


def hard_case(name: str, points: int = 6, *, seed: int = 0, dtype: torch.dtype = torch.float64) -> ConvexField:
    """A random field whose convexes are difficult in one way."""
    size = {"tiny": 1e-4, "huge": 3.0}.get(name, 0.2)
    field = random_field(5, points=points, seed=seed, size=size, edge=30.0)
    values = list(field.tensors())
    shift = {"behind": -3.0, "near": -2.0}.get(name, 0.0)
    values[0] = values[0] + values[0].new_tensor([0.3 * -shift / 2, shift, 0.0])
    if name == "edge_on":  # in the plane through the camera and the z axis, turned by next to nothing
        values[0] = values[0] * values[0].new_tensor([1e-9, 1.0, 1.0])
        values[0] = values[0] + values[0][..., 1:2] * values[0].new_tensor([-0.15, 0.0, 0.0])
    if name == "flat_points":  # three of the points are one
        values[0] = torch.cat([values[0][:, :1].expand(-1, 3, -1), values[0][:, 3:]], dim=1)
    if name == "opaque":
        values[1], values[3] = values[1] * 100, torch.ones_like(values[3])
    if name == "faint":
        values[3] = values[3].new_tensor([0.0, 1 / 300, 1 / 200, 0.01, 0.02])
    return ConvexField(*values).to(dtype)
