"""One closed surface around convexes that overlap."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_closing, binary_fill_holes, gaussian_filter

from physconvex.convex import ConvexField, inside_union
from physconvex.errors import InputError
from physconvex.play.assets import RestSurface
from physconvex.reconstruction import level_surface

CELLS = 64  # along the longest edge
SMOOTH = 0.7  # cells


def surface_of_union(field: ConvexField) -> RestSurface:
    """Closed surface around the union of the hulls [m], without cavities: however many they are, and overlap.

    Gaps narrower than a cell, a 64th of the longest edge, are closed.

    Raises:
        InputError: the hulls fill no cell.
    """
    corners = field.points.detach().cpu().numpy().astype(np.float64).reshape(-1, 3)
    low, extent = corners.min(axis=0), np.ptp(corners, axis=0)
    cell = float(extent.max()) / CELLS
    ticks = [low[k] + cell * np.arange(-1.5, np.ceil(extent[k] / cell) + 2) for k in range(3)]
    lattice = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1)
    inside = inside_union(field, lattice.reshape(-1, 3)).reshape(lattice.shape[:3])
    if not inside.any():
        raise InputError(
            f"convexes: the hulls of {len(field)} fill no cell of {cell:.3g} m; expected solid convexes, of four or "
            "more points each, or the folder of the reconstruction, whose body.ply is the solid"
        )
    solid = gaussian_filter(binary_fill_holes(binary_closing(inside)).astype(np.float64), SMOOTH)
    surface = level_surface(cell * (0.5 - solid), origin=lattice[0, 0, 0], cell=cell)
    return RestSurface(np.asarray(surface.vertices, dtype=np.float64), np.asarray(surface.faces))
