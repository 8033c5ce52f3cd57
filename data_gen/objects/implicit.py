"""Bodies as implicit functions: primitives, smooth combinations, and the triangle surface of a zero level.

A `Field` maps points [N, 3] to values [N], negative inside. Near the surface the values are roughly distances.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

Field = Callable[[Float[np.ndarray, "N 3"]], Float[np.ndarray, " N"]]


def ellipsoid(centre: np.ndarray, radii: np.ndarray | float) -> Field:
    """Ellipsoid with axes along x, y, z; first-order distance (Quilez)."""
    radii = np.broadcast_to(np.asarray(radii, dtype=np.float64), 3)

    def field(p: np.ndarray) -> np.ndarray:
        q = (p - centre) / radii
        length = np.linalg.norm(q, axis=1)
        slope = np.linalg.norm(q / radii, axis=1)
        return np.where(slope > 1e-9, length * (length - 1) / np.maximum(slope, 1e-9), -radii.min())

    return field


def box(half: np.ndarray, rounding: float) -> Field:
    """Box of half edges `half` with edges rounded by the radius `rounding`."""

    def field(p: np.ndarray) -> np.ndarray:
        q = np.abs(p) - (np.asarray(half) - rounding)
        return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0) - rounding

    return field


def cylinder(radius: float, half_height: float, rounding: float) -> Field:
    """Cylinder about z with rounded edges."""

    def field(p: np.ndarray) -> np.ndarray:
        q = np.stack([np.hypot(p[:, 0], p[:, 1]) - radius, np.abs(p[:, 2]) - half_height], axis=1) + rounding
        return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0) - rounding

    return field


def torus(ring: float, tube: float) -> Field:
    """Torus about z."""
    return lambda p: np.hypot(np.hypot(p[:, 0], p[:, 1]) - ring, p[:, 2]) - tube


def capsule(start: np.ndarray, end: np.ndarray, radius_start: float, radius_end: float) -> Field:
    """Segment with a radius that changes linearly along it."""
    start, along = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64) - start
    square = max(float(along @ along), 1e-12)

    def field(p: np.ndarray) -> np.ndarray:
        t = np.clip((p - start) @ along / square, 0.0, 1.0)
        return np.linalg.norm(p - start - t[:, None] * along, axis=1) - (radius_start + t * (radius_end - radius_start))

    return field


def moved(field: Field, *, shift: np.ndarray | None = None, rotation: np.ndarray | None = None) -> Field:
    """`field` rotated by `rotation` [3, 3], then shifted."""
    turn = np.eye(3) if rotation is None else rotation
    offset = np.zeros(3) if shift is None else np.asarray(shift)
    return lambda p: field((p - offset) @ turn)


def rotation_about(axis: np.ndarray, angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation matrix about `axis` by `angle` [rad] (Rodrigues)."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def smooth_union(fields: list[Field], blend: float) -> Field:
    """Union whose seams are filled over the width `blend` (polynomial smooth minimum of Quilez)."""

    def field(p: np.ndarray) -> np.ndarray:
        result = fields[0](p)
        for other in fields[1:]:
            result = _smooth_minimum(result, other(p), blend)
        return result

    return field


def smooth_difference(field: Field, hole: Field, blend: float) -> Field:
    """`field` without `hole`, the new edges rounded over the width `blend`."""
    return lambda p: -_smooth_minimum(-field(p), hole(p), blend)


def smooth_intersection(fields: list[Field], blend: float) -> Field:
    """Common part, the new edges rounded over the width `blend`."""
    negative = smooth_union([negated(field) for field in fields], blend)
    return negated(negative)


def negated(field: Field) -> Field:
    """Inside and outside exchanged."""
    return lambda p: -field(p)


def _smooth_minimum(a: np.ndarray, b: np.ndarray, blend: float) -> np.ndarray:
    overlap = np.maximum(blend - np.abs(a - b), 0.0) / blend
    return np.minimum(a, b) - 0.25 * blend * overlap**2


def surface(
    field: Field, bounds: Float[np.ndarray, "2 3"], spacing: float
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Outward oriented triangles of the zero level, by marching cubes and projection onto the level.

    Raises:
        ValueError: the field has no zero inside `bounds`.
    """
    import pyvista

    values, origin = sampled(field, bounds, spacing)
    grid = pyvista.ImageData(dimensions=values.shape, spacing=(spacing,) * 3, origin=origin)
    grid.point_data["values"] = values.ravel(order="F")
    level = grid.contour([0.0], scalars="values", method="flying_edges")
    if level.n_points == 0:
        raise ValueError("field: no zero inside bounds; expected a body inside")
    vertices = project_to_surface(field, np.asarray(level.points, dtype=np.float64), spacing)
    return vertices, np.asarray(level.regular_faces[:, ::-1], dtype=np.int64)


def sampled(field: Field, bounds: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Values on a regular grid that covers `bounds` and two spacings more, and the grid's origin."""
    bounds = np.asarray(bounds, dtype=np.float64)
    counts = np.ceil((bounds[1] - bounds[0]) / spacing).astype(int) + 5
    origin = bounds.mean(axis=0) - 0.5 * (counts - 1) * spacing
    axes = [origin[a] + spacing * np.arange(counts[a]) for a in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return field(points).reshape(counts), origin


def project_to_surface(field: Field, points: np.ndarray, spacing: float) -> np.ndarray:
    """Points moved onto the zero level by two Newton steps along the gradient, each at most a tenth of `spacing`."""
    step = 1e-3 * spacing
    for _ in range(2):
        gradient = np.stack([field(points + step * e) - field(points - step * e) for e in np.eye(3)], axis=1) / (
            2 * step
        )
        square = np.einsum("na,na->n", gradient, gradient)
        shift = -gradient * (field(points) / np.maximum(square, 1e-6))[:, None]
        length = np.linalg.norm(shift, axis=1, keepdims=True)
        points = points + shift * np.minimum(1.0, 0.1 * spacing / np.maximum(length, 1e-12))
    return points
