"""The visual hull: the region that projects into every mask (Laurentini 1994)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyvista as pv
import trimesh
from jaxtyping import Float
from scipy.ndimage import gaussian_filter, map_coordinates

from physconvex.errors import InputError
from physconvex.reconstruction.observation import Observation

CELLS = 96  # along an edge of the cube
MARGIN = 1.15  # of the cube around the bounds of the views
REMEDY = "check the cameras' poses (camera-to-world, OpenGL axes, metres) and the masks"


def object_box(observations: Sequence[Observation]) -> tuple[Float[np.ndarray, " 3"], float]:
    """Centre [m] and half edge [m] of a cube that holds the object.

    The centre is the point nearest (least squares) to the rays through the middles of the masks. The edge is the extent
    of the largest mask at its distance.

    Raises:
        InputError: the rays are parallel, or the point is behind a camera.
    """
    system, right, rays = np.zeros((3, 3)), np.zeros(3), []
    for seen in observations:
        rows, columns = np.nonzero(seen.coverage.numpy() > 0.5)
        middle = np.array([0.5 * (columns.min() + columns.max() + 1), 0.5 * (rows.min() + rows.max() + 1)])
        origin, direction = seen.camera.rays(middle)
        across = np.eye(3) - np.outer(direction, direction)
        system, right = system + across, right + across @ origin
        rays.append((seen.camera, max(np.ptp(rows), np.ptp(columns)) + 1))
    if np.linalg.cond(system) > 1e6:
        raise InputError(f"cameras: all look along parallel lines, so the object's place is not known; {REMEDY}")
    centre = np.linalg.solve(system, right)
    depths = [float(camera.project(centre)[1]) for camera, _ in rays]
    if min(depths) <= 0:
        behind = rays[int(np.argmin(depths))][0].name
        raise InputError(f"camera {behind!r}: the place where the views meet lies behind it; {REMEDY}")
    spans = [pixels * depth / min(c.fl_x, c.fl_y) for (c, pixels), depth in zip(rays, depths, strict=True)]
    return centre, 0.5 * MARGIN * max(spans)


def footprint(observations: Sequence[Observation]) -> float:
    """Size of a pixel at the object: mean over the views [m]."""
    centre, _ = object_box(observations)
    cameras = [seen.camera for seen in observations]
    return float(np.mean([float(c.project(centre)[1]) / np.sqrt(c.fl_x * c.fl_y) for c in cameras]))


def hull_distance(observations: Sequence[Observation], positions: Float[np.ndarray, "Q 3"]) -> Float[np.ndarray, " Q"]:
    """Signed distance [m] of positions from the visual hull, negative inside.

    The greatest, over the views, of the distance in the picture to the silhouette's edge at the position's depth.
    """
    greatest = np.full(len(positions), -np.inf)
    for seen in observations:
        place, depth = seen.camera.project(positions)
        found = map_coordinates(seen.edge_distance, (place - 0.5).T[::-1], order=1, mode="nearest")
        away = found * depth / np.sqrt(seen.camera.fl_x * seen.camera.fl_y)
        greatest = np.maximum(greatest, np.where(depth > 0, away, np.inf))
    return greatest


def visual_hull(observations: Sequence[Observation], *, cells: int = CELLS) -> trimesh.Trimesh:
    """Surface of the visual hull, from a lattice of `cells`³.

    Raises:
        InputError: nothing projects into all masks.
    """
    centre, half = object_box(observations)
    steps = np.linspace(-half, half, cells + 1)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1) + centre
    inside = np.ones(grid.shape[:3], dtype=bool)
    for seen in observations:
        pixels, depth = seen.camera.project(grid[inside])
        place = np.floor(np.nan_to_num(pixels, nan=-1.0)).astype(int)
        mask = seen.coverage.numpy() > 0.5
        within = (depth > 0) & (place >= 0).all(axis=1) & (place < [seen.camera.w, seen.camera.h]).all(axis=1)
        hit = np.zeros(len(place), dtype=bool)
        hit[within] = mask[place[within, 1], place[within, 0]]
        inside[inside] = hit
    if not inside.any():
        raise InputError(f"masks: no point in space projects into all {len(observations)} of them; {REMEDY}")
    smooth = gaussian_filter(np.pad(inside, 1).astype(np.float32), 0.7)
    return level_surface(smooth, 0.5, origin=centre - half - steps[1] + steps[0], cell=steps[1] - steps[0])


def level_surface(
    values: Float[np.ndarray, "n n n"], level: float, *, origin: Float[np.ndarray, " 3"], cell: float
) -> trimesh.Trimesh:
    """Outward oriented surface [m] where values on a lattice reach a level; closed if none at the border does.

    Args:
        origin: place of the first value [m].
        cell: distance between neighbours [m].
    """
    image = pv.ImageData(dimensions=values.shape, spacing=[cell] * 3, origin=origin)
    found = image.contour([level], scalars=values.ravel(order="F"), method="flying_edges")
    surface = trimesh.Trimesh(found.points, found.regular_faces, process=False)
    if surface.volume < 0:
        surface.invert()
    return surface
