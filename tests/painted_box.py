"""A box of wedges in random colours, as a convex field."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
import trimesh

if TYPE_CHECKING:
    from physconvex.convex import ConvexField


def painted_wedges(low: np.ndarray, high: np.ndarray) -> ConvexField:
    """12 wedges that fill a box [m], in float64, whose harmonics depend on the direction."""
    from physconvex.convex import ConvexField, coefficients_of_colour

    rng, counts = np.random.default_rng(0), (3, 2, 1)
    wedges = []
    for cell in np.ndindex(counts):
        a, b = (low + (high - low) * (np.array(cell) + k) / counts for k in (0, 1))
        corners = np.array([[x, y, z] for z in (a[2], b[2]) for x, y in ((a[0], a[1]), (b[0], a[1]), (b[0], b[1]))])
        other = np.array([[x, y, z] for z in (a[2], b[2]) for x, y in ((a[0], a[1]), (b[0], b[1]), (a[0], b[1]))])
        wedges += [corners, other]
    points = torch.as_tensor(np.array(wedges))
    ones = torch.ones(len(points), dtype=torch.float64)
    colours = coefficients_of_colour(torch.as_tensor(rng.uniform(0.1, 0.9, (len(points), 3))))
    colours[:, 1:4] += torch.as_tensor(rng.normal(scale=0.05, size=(len(points), 3, 3)))
    return ConvexField(points, 200 * ones, ones, 0.98 * ones, colours)


def box_surface(low: np.ndarray, high: np.ndarray) -> trimesh.Trimesh:
    """Its closed surface [m]."""
    box = trimesh.creation.box(high - low)
    box.apply_translation((low + high) / 2)
    return box
