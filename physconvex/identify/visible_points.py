"""Which surface point each pixel of a camera sees: rays against a triangle mesh (trimesh, Embree)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from physconvex.io import Camera


@dataclass(frozen=True, eq=False)
class Hits:
    """Hit points of rays.

    Attributes:
        faces: triangle of each ray, −1 for none, shape [...].
        barycentric: where in it, shape [..., 3].
    """

    faces: Int[np.ndarray, "*R"]
    barycentric: Float[np.ndarray, "*R 3"]

    def on(self, vertices: Float[np.ndarray, "V c"], triangles: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "... c"]:
        """Values at the hit points for given values at the vertices; NaN where nothing is hit."""
        corners = vertices[triangles[np.maximum(self.faces, 0)]]
        values = (self.barycentric[..., None] * corners).sum(-2)
        return np.where((self.faces >= 0)[..., None], values, np.nan)


def cast_rays(
    origins: Float[np.ndarray, "... 3"],
    directions: Float[np.ndarray, "... 3"],
    vertices: Float[np.ndarray, "V 3"],
    triangles: Int[np.ndarray, "F 3"],
) -> Hits:
    """First hits of rays [m]."""
    import trimesh

    shape = directions.shape[:-1]
    origin = np.broadcast_to(origins, directions.shape).reshape(-1, 3)
    flat = directions.reshape(-1, 3)
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    faces = np.asarray(mesh.ray.intersects_first(origin, flat))
    return Hits(faces.reshape(shape), _barycentric(origin, flat, vertices, triangles, faces).reshape(*shape, 3))


def cast_camera_rays(camera: Camera, vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"]) -> Hits:
    """First hits of the rays through all pixel centres, shape [h, w]."""
    origin, directions = camera.rays()
    return cast_rays(origin, directions, vertices, triangles)


def _barycentric(
    origin: np.ndarray, direction: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Möller & Trumbore 1997."""
    a, b, c = np.moveaxis(vertices[triangles[np.maximum(faces, 0)]], 1, 0)
    edge1, edge2, arm = b - a, c - a, origin - a
    p = np.cross(direction, edge2)
    determinant = (edge1 * p).sum(-1)
    determinant = np.where(np.abs(determinant) > 1e-300, determinant, np.inf)
    u = (arm * p).sum(-1) / determinant
    v = (direction * np.cross(arm, edge1)).sum(-1) / determinant
    return np.stack([1 - u - v, u, v], axis=-1)


def unit_normals(vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """Unit normals of triangles, by the order of their corners; zero for triangles without area."""
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300))


def shaded(
    camera: Camera, vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "F 3"], hits: Hits
) -> Float[np.ndarray, "h w"]:
    """Grey values of a surface lit from the camera, 0 to 255."""
    facing = np.abs(unit_normals(vertices, triangles) @ camera.rotation[:, 2])
    return np.asarray(70.0 + 150.0 * facing[np.maximum(hits.faces, 0)])
