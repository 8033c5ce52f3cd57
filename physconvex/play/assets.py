"""Objects to play: a mesh file, a convex field, or a result of `physconvex refine`; sized, rotated and placed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from physconvex.convex import ConvexField, hull_mesh, read_ply
from physconvex.errors import InputError
from physconvex.play.config import StartConfig

_FIELD_MARK = b"element convex "


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


@dataclass(frozen=True)
class Asset:
    """An object at rest.

    Attributes:
        surface: its surface.
        convexes: the convex field that moves with it, if there is one.
        overlapping: whether the surface is the hulls of the field, which may overlap.
        settings: sections of the configuration from the file, such as a refined material.
    """

    surface: RestSurface
    convexes: ConvexField | None = None
    overlapping: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)


def read_asset(path: str | Path) -> Asset:
    """Read a mesh file, a PLY file of a convex field, or a folder of `physconvex refine` or `physconvex reconstruct`.

    Of a refinement the surface at t = 0 and E, ν, damping time and density are used, not the scene of the capture. Of a
    reconstruction the closed surface moves, and the convex field with it.

    Raises:
        InputError: none of these, or unreadable.
    """
    path = Path(path)
    if path.is_dir() and (path / "reconstruction.json").exists() and (path / "body.ply").exists():
        return Asset(read_surface(path / "body.ply"), read_ply(path / "field.ply"))
    if path.is_dir():
        return _refined(path)
    if path.suffix.lower() == ".ply" and path.is_file() and _FIELD_MARK in path.read_bytes()[:4000]:
        convexes = read_ply(path)
        hulls = hull_mesh(convexes)
        if hulls.is_empty:
            raise InputError(f"{path}: no convex has a face; expected a field with solid convexes")
        return Asset(RestSurface(np.asarray(hulls.vertices), np.asarray(hulls.faces)), convexes, overlapping=True)
    return Asset(read_surface(path))


def _refined(folder: Path) -> Asset:
    """Surface and material of a refinement."""
    try:
        found = json.loads((folder / "refinement.json").read_text(encoding="utf-8"))
        with np.load(folder / "trajectory.npz") as arrays:
            surface = RestSurface(np.asarray(arrays["vertices"][0], dtype=np.float64), np.asarray(arrays["faces"]))
        known = {name: entry["value"] for name, entry in found["parameters"].items()}
        known |= {name: entry["value"] if isinstance(entry, dict) else entry for name, entry in found["fixed"].items()}
        material = {"youngs_modulus": float(found["youngs_modulus"]["value"])}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{folder}: expected a folder of `physconvex refine` with refinement.json and trajectory.npz ({error})"
        ) from error
    material |= {name: float(known[name]) for name in ("poisson_ratio", "damping_time", "density") if name in known}
    return Asset(surface, settings={"material": material})


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
