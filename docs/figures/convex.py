"""Picture of docs/concepts/convex_field.md: a lobed body of triangular prisms, drawn by the rasteriser.

python docs/figures/convex.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
import trimesh

from physconvex.convex import ConvexField, coefficients_of_colour
from physconvex.io import look_at
from physconvex.render import render

OUT = Path(__file__).parents[1] / "images" / "convex.png"
SIZE = 320


def blob() -> trimesh.Trimesh:
    """A sphere with three lobes and a waist, about 1 m across."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    x, y, z = (mesh.vertices / 0.5).T
    radius = 1 + 0.18 * np.cos(3 * np.arctan2(y, x)) * (1 - z**2) - 0.3 * np.exp(-((z - 0.45) ** 2) / 0.03)
    mesh.vertices *= radius[:, None]
    return mesh


def prisms(mesh: trimesh.Trimesh, *, thickness: float, softness: float) -> ConvexField:
    """A prism of six points under every triangle, its edges `softness` [m] wide, lit from the upper left."""
    inner = mesh.vertices - thickness * mesh.vertex_normals
    points = np.concatenate([mesh.vertices[mesh.faces], inner[mesh.faces]], axis=1)
    height, angle = mesh.triangles_center[:, 2], np.arctan2(*mesh.triangles_center[:, :2].T)
    stripes = (np.sin(24 * height + 2 * np.sin(3 * angle)) > 0)[:, None]
    paint = np.where(stripes, [0.95, 0.62, 0.25], [0.25, 0.45, 0.70])
    light = np.array([-0.4, -0.7, 0.6]) / np.linalg.norm([-0.4, -0.7, 0.6])
    shade = 0.35 + 0.65 * np.clip(mesh.face_normals @ light, 0, None)
    ones = torch.ones(len(points))
    colours = torch.as_tensor(paint * shade[:, None], dtype=torch.float32)
    return ConvexField(
        torch.as_tensor(points, dtype=torch.float32),
        ones * 4 / softness,
        ones,
        ones * 0.95,
        coefficients_of_colour(colours),
    )


def main() -> None:
    """Draw the four panels."""
    camera = look_at((0.6, -2.4, 0.9), (0, 0, 0), width=SIZE, height=SIZE, vertical_field_of_view=0.5)
    mesh = blob()
    sharp = render(prisms(mesh, thickness=0.03, softness=0.002), camera)
    soft = render(prisms(mesh, thickness=0.03, softness=0.05), camera)
    shuffled = np.random.default_rng(0).uniform(0.2, 1.0, (len(mesh.faces) + 1, 3))
    shuffled[-1] = 1.0  # index −1 is the background
    near, far = sharp.depth[sharp.depth.isfinite()].aminmax()
    depth = ((far - sharp.depth) / (far - near)).clamp(0, 1).numpy()
    panels = {
        f"{len(mesh.faces)} prisms, edges 2 mm wide": sharp.colour.clamp(0, 1).numpy(),
        "the same, edges 50 mm wide": soft.colour.clamp(0, 1).numpy(),
        "the convex of greatest weight": shuffled[sharp.convex.numpy()],
        "depth": depth,
    }
    figure, axes = plt.subplots(1, len(panels), figsize=(12, 3.3), layout="constrained")
    for axis, (title, picture) in zip(axes, panels.items(), strict=True):
        axis.imshow(picture, cmap="magma")
        axis.set_title(title, fontsize=9)
        axis.axis("off")
    figure.savefig(OUT, dpi=110)


if __name__ == "__main__":
    main()
