"""Points of triangles nearest to given ones."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def closest_in_triangles(
    triangles: Float[np.ndarray, "*#B 3 3"], points: Float[np.ndarray, "*#B 3"]
) -> Float[np.ndarray, "*#B 3"]:
    """Barycentric coordinates of the point of each triangle that is closest to each point.

    Inside where the foot of the perpendicular is inside, else on the nearest of the three edges.
    """
    u, v = triangles[..., 1, :] - triangles[..., 0, :], triangles[..., 2, :] - triangles[..., 0, :]
    w = points - triangles[..., 0, :]
    uu, uv, vv, wu, wv = _dot(u, u), _dot(u, v), _dot(v, v), _dot(w, u), _dot(w, v)
    square = np.maximum(uu * vv - uv * uv, 1e-300)
    s, t = (vv * wu - uv * wv) / square, (uu * wv - uv * wu) / square
    result = np.stack([1 - s - t, s, t], axis=-1)
    outside = (result < 0).any(axis=-1)
    if outside.any():
        corners = np.broadcast_to(triangles, (*outside.shape, 3, 3))[outside]
        result[outside] = _closest_on_edges(corners, np.broadcast_to(points, result.shape)[outside])
    return result


def _closest_on_edges(
    triangles: Float[np.ndarray, "N 3 3"], points: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "N 3"]:
    along = triangles[:, [1, 2, 0]] - triangles
    offset = points[:, None] - triangles
    share = (_dot(offset, along) / np.maximum(_dot(along, along), 1e-300)).clip(0.0, 1.0)
    away = offset - share[..., None] * along
    edge = np.sqrt(_dot(away, away)).argmin(axis=1)
    rows, result = np.arange(len(points)), np.zeros((len(points), 3))
    result[rows, edge], result[rows, (edge + 1) % 3] = 1 - share[rows, edge], share[rows, edge]
    return result


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def closest_points(
    triangles: Float[np.ndarray, "*#B 3 3"], points: Float[np.ndarray, "*#B 3"]
) -> Float[np.ndarray, "*#B 3"]:
    """The point of each triangle that is closest to each point, by perpendiculars; no triangle may be flat.

    The weights of `closest_in_triangles` give it too, but round differently: use this one for bit-identical results.
    """
    normal = np.cross(triangles[..., 1, :] - triangles[..., 0, :], triangles[..., 2, :] - triangles[..., 0, :])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    height = np.einsum("...a,...a->...", normal, points - triangles[..., 0, :])
    inside = np.ones(height.shape, dtype=bool)
    nearest, gap = np.zeros((*height.shape, 3)), np.full(height.shape, np.inf)
    for i in range(3):
        start, along = triangles[..., i, :], triangles[..., (i + 1) % 3, :] - triangles[..., i, :]
        offset = points - start
        inside &= np.einsum("...a,...a->...", np.cross(along, offset), normal) >= 0
        t = np.einsum("...a,...a->...", offset, along) / np.einsum("...a,...a->...", along, along)
        foot = start + np.clip(t, 0, 1)[..., None] * along
        away = np.linalg.norm(points - foot, axis=-1)
        nearest = np.where((away < gap)[..., None], foot, nearest)
        gap = np.minimum(gap, away)
    return np.where(inside[..., None], points - height[..., None] * normal, nearest)
