"""The surface of the visual hull, and that of any signed distances on a lattice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyvista as pv
import trimesh
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from physconvex.reconstruction.carving import cube_lattice, object_box
from physconvex.reconstruction.observation import Observation
from physconvex.reconstruction.photo_consistency import nearest_pixels
from physconvex.reconstruction.view_checks import nothing_in_common

CELLS = 96  # along an edge of the cube
SMOOTH = 0.7  # cells
LEAST = 0.01  # cells: a surface through a point of the lattice has flat triangles


def visual_hull(observations: Sequence[Observation], *, cells: int = CELLS) -> trimesh.Trimesh:
    """Closed surface of the visual hull, from a lattice of `cells`³.

    Raises:
        InputError: nothing projects into all silhouettes; the message names the camera that disagrees most.
    """
    centre, half = object_box(observations)
    lattice, cell = cube_lattice(centre, half, cells)
    inside = np.ones(len(lattice), dtype=bool)
    for seen in observations:
        place, depth = nearest_pixels(seen.camera, lattice[inside])  # beside a picture as at its border: not known
        inside[inside] = (depth > 0) & (seen.coverage.numpy() > 0.5)[place]
    if not inside.any():
        raise nothing_in_common(observations)
    solid = gaussian_filter(np.pad(inside.reshape((cells + 1,) * 3), 1).astype(np.float64), SMOOTH)
    return level_surface(cell * (0.5 - solid), origin=centre - half - cell, cell=cell)


def level_surface(
    distance: Float[np.ndarray, "n n n"], *, origin: Float[np.ndarray, " 3"], cell: float
) -> trimesh.Trimesh:
    """Closed, outward oriented surface [m] around the negative values of signed distances on a lattice [m].

    Args:
        distance: at the points of the lattice; beyond it all is outside.
        origin: place of the first value.
        cell: distance between neighbours.
    """
    away = np.where(distance < 0, np.minimum(distance, -LEAST * cell), np.maximum(distance, LEAST * cell))
    values = np.pad(away, 1, constant_values=cell)
    image = pv.ImageData(dimensions=values.shape, spacing=[cell] * 3, origin=origin - cell)
    found = image.contour([0.0], scalars=values.ravel(order="F"), method="flying_edges")
    surface = trimesh.Trimesh(found.points, found.regular_faces, process=False)
    if surface.volume < 0:
        surface.invert()
    return surface
