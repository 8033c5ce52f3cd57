"""The surface to play: read from a mesh file, sized, rotated and placed over the floor."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from physconvex.errors import InputError
from physconvex.play.config import StartConfig


@dataclass(frozen=True)
class RestSurface:
    """Triangles at rest.

    Attributes:
        vertices: [m], z up, shape [V, 3].
        faces: shape [F, 3].
    """

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]

    def placement(self, config: StartConfig, *, ground: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """The map x = linear X + shift that sizes and rotates it, and puts its lowest point over the ground.

        Args:
            config: size, turns, height, place.
            ground: height above which `drop_height` counts [m].
        """
        middle = 0.5 * (self.vertices.min(0) + self.vertices.max(0))
        scale = 1.0 if config.size is None else config.size / np.ptp(self.vertices, axis=0).max()
        linear = scale * Rotation.from_euler("xyz", config.orientation_deg, degrees=True).as_matrix()
        lowest = float(((self.vertices - middle) @ linear.T)[:, 2].min())
        return linear, np.array([*config.position, ground + config.drop_height - lowest]) - linear @ middle

    def moved(self, linear: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, " 3"]) -> RestSurface:
        """The surface after x = linear X + shift."""
        return RestSurface(self.vertices @ linear.T + shift, self.faces)

    def placed(self, config: StartConfig) -> RestSurface:
        """The surface where it starts."""
        return self.moved(*self.placement(config))

    def contact_points(self, limit: int) -> tuple[Float[np.ndarray, "S 3"], Float[np.ndarray, " S"]]:
        """Points of contact [m] and the area of each [m²]: the vertices, or `limit` of them.

        Every vertex carries a third of the triangles around it, or passes that to the nearest chosen vertex.
        """
        corners = self.vertices[self.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.zeros(len(self.vertices))
        np.add.at(areas, self.faces, np.linalg.norm(normals, axis=1)[:, None] / 6)
        chosen = np.arange(len(areas))
        if len(chosen) > limit:
            chosen = np.random.default_rng(0).choice(len(areas), limit, replace=False, p=areas / areas.sum())
        _, nearest = cKDTree(self.vertices[chosen]).query(self.vertices)
        return self.vertices[chosen], np.bincount(nearest, areas, minlength=len(chosen))


def read_surface(path: str | Path) -> RestSurface:
    """Read any mesh file that trimesh reads; several parts become one; glTF, whose y axis is up, is rotated.

    Raises:
        InputError: the file is missing or unreadable, or holds no surface with an extent in all three directions.
    """
    import trimesh

    path = Path(path)
    if not path.is_file():
        raise InputError(f"mesh: {path} is not a file; expected a mesh such as .obj, .ply, .stl, .glb or .off")
    try:
        mesh = trimesh.load_mesh(path, process=True)
    except Exception as error:  # trimesh raises many types, depending on the format
        raise InputError(f"mesh: {path} cannot be read as a mesh ({error}); export it again") from error
    vertices = np.asarray(getattr(mesh, "vertices", np.zeros((0, 3))), dtype=np.float64)
    faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), dtype=np.int64)
    if len(faces) == 0 or not np.isfinite(vertices).all() or np.ptp(vertices, axis=0).min() <= 0:
        raise InputError(
            f"mesh: {path} holds {len(faces)} triangles of {len(vertices)} vertices; expected a solid body"
        )
    if path.suffix.lower() in (".glb", ".gltf"):
        vertices = vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    return RestSurface(vertices, faces)
