"""The visual hull, the region that projects into every silhouette (Laurentini 1994): its box, and distances from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

from physconvex.errors import InputError
from physconvex.reconstruction.observation import Observation

MARGIN = 1.15  # of the cube around the bounds of the views
MOST_CELLS, LEAST_CELLS, PIXELS = 128, 24, 2.0  # along its edge, of the body's lattice; pixels a cell, at least
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


def cell_of(observations: Sequence[Observation]) -> float:
    """Edge [m] of a cell of the body's lattice: two pixels, or a 128th of the cube around the object."""
    _, half = object_box(observations)
    return 2 * half / int(np.clip(2 * half / (PIXELS * footprint(observations)), LEAST_CELLS, MOST_CELLS))


def cube_lattice(centre: Float[np.ndarray, " 3"], half: float, cells: int) -> tuple[Float[np.ndarray, "Q 3"], float]:
    """Points of a lattice of `cells`³ cells in a cube [m], the last coordinate fastest, and the edge of a cell [m]."""
    ticks = np.linspace(-half, half, cells + 1)
    points = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3) + centre
    return points, float(ticks[1] - ticks[0])


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
