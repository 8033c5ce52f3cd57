"""The points of single hulls: corners, volume, cuts, fewer points. Small sets, in numpy."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

LEAST_SOLID = 4  # points of a hull with volume


def hull_volume(points: Float[np.ndarray, "C 3"]) -> float:
    """Volume of the hull [m³]; zero for points in a plane."""
    hull = _hull(points)
    return 0.0 if hull is None else float(hull.volume) * _scale(points) ** 3


def corners_of(points: Float[np.ndarray, "C 3"]) -> Int[np.ndarray, " M"]:
    """Indices of the points that are corners of the hull; all of them if the points lie in a plane."""
    hull = _hull(points)
    return np.arange(len(points)) if hull is None else np.sort(hull.vertices)


def hull_triangles(points: Float[np.ndarray, "C 3"]) -> tuple[Int[np.ndarray, " M"], Int[np.ndarray, "F 3"]]:
    """Indices of the corners of a hull with volume, and its triangles as places among them, outward."""
    hull = ConvexHull((points - points.mean(axis=0)) / _scale(points))
    corners = np.sort(hull.vertices)
    return corners, np.searchsorted(corners, outward_faces(hull))


def outward_faces(hull: ConvexHull) -> Int[np.ndarray, "F 3"]:
    """Triangles of a hull, anticlockwise seen from outside."""
    a, b, c = np.moveaxis(hull.points[hull.simplices], 1, 0)
    inward = np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    return np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)


def planar_corners(points: Float[np.ndarray, "C 3"]) -> Int[np.ndarray, " M"]:
    """Indices of the corners of the hull of points in a plane, in order around it; none if they lie on a line."""
    centred = (points - points.mean(axis=0)) / _scale(points)
    plane = centred @ np.linalg.svd(centred, full_matrices=False)[2][:2].T
    try:
        return np.asarray(ConvexHull(plane).vertices)
    except QhullError:
        return np.zeros(0, dtype=np.int64)


def cut_points(
    points: Float[np.ndarray, "C 3"], normal: Float[np.ndarray, " 3"], offset: float
) -> Float[np.ndarray, "M 3"]:
    """Points whose hull is the part of the hull with n · x ≤ d; none if nothing is left.

    The cut of a hull with a plane is the hull of the cuts of all segments between points on either side.
    """
    height = points @ normal - offset
    below, above = np.flatnonzero(height <= 0), np.flatnonzero(height > 0)
    if not len(above) or not len(below):
        return points[below]
    share = height[below][:, None] / (height[below][:, None] - height[above])
    between = points[below][:, None] + share[..., None] * (points[above] - points[below][:, None])
    kept = np.concatenate([points[below], between.reshape(-1, 3)])
    return kept[corners_of(kept)]


def fewer_points(points: Float[np.ndarray, "C 3"], count: int) -> Float[np.ndarray, "M 3"]:
    """At most `count` of the corners: the least prominent corner is removed repeatedly.

    The measure is the volume of the pyramids from the faces about a corner to the mean of the neighbouring corners. If
    those neighbours lie in a plane, it is an upper bound on the lost volume. Of points in a plane, it is the area.
    """
    points = points[corners_of(points)]
    while len(points) > count:
        hull = _hull(points)
        if hull is None:
            return _fewer_in_plane(points, count)
        points = np.delete(points, _protrusions(points, hull.simplices).argmin(), axis=0)
    return points


def _fewer_in_plane(points: Float[np.ndarray, "C 3"], count: int) -> Float[np.ndarray, "M 3"]:
    """At most `count` of the corners: that of the smallest triangle with its neighbours is removed repeatedly."""
    corners = points[planar_corners(points)]
    if not len(corners):
        return points[:count]
    while len(corners) > count:
        sides = np.roll(corners, 1, axis=0) - corners, np.roll(corners, -1, axis=0) - corners
        corners = np.delete(corners, np.linalg.norm(np.cross(*sides), axis=1).argmin(), axis=0)
    return corners


def _protrusions(points: np.ndarray, faces: np.ndarray) -> Float[np.ndarray, " C"]:
    """Volume of the pyramids of each corner [m³]."""
    found = np.zeros(len(points))
    for corner in range(len(points)):
        mine = faces[(faces == corner).any(axis=1)]
        if not len(mine):
            continue  # within rounding of the hull of the others
        neighbours = np.setdiff1d(mine, corner)
        sides = points[mine] - points[neighbours].mean(axis=0)
        found[corner] = np.abs(np.linalg.det(sides)).sum() / 6
    return found


def padded_points(points: Float[np.ndarray, "C 3"], count: int) -> Float[np.ndarray, "K 3"]:
    """The points, the first repeated until there are `count`."""
    return np.concatenate([points, np.repeat(points[:1], count - len(points), axis=0)])


def _scale(points: np.ndarray) -> float:
    return max(float(np.ptp(points, axis=0).max()), np.finfo(float).tiny)


def _hull(points: np.ndarray) -> ConvexHull | None:
    """Qhull's result for the points at unit size, None if they have no volume."""
    if len(points) < 4:
        return None
    try:
        return ConvexHull((points - points.mean(axis=0)) / _scale(points))
    except QhullError:
        return None
