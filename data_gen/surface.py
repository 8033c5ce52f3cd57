"""What is drawn: a surface, its normals while it deforms, light, floor and background."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int, UInt8

from physconvex import InputError


@dataclass(frozen=True, eq=False)
class DrawnSurface:
    """A triangle surface with colours at its vertices or a texture.

    Attributes:
        vertices: rest positions [m], shape [P, 3].
        faces: vertex indices, shape [F, 3], outward.
        colors: RGB at the vertices, shape [P, 3] uint8, or None.
        uv: texture coordinates, shape [P, 2] ((0, 0) is the lower left corner of the texture), or None.
        texture: RGB image, shape [h, w, 3] uint8, or None.

    Raises:
        InputError: neither colours nor a texture with its coordinates, or shapes that do not match.
    """

    vertices: Float[np.ndarray, "P 3"]
    faces: Int[np.ndarray, "F 3"]
    colors: UInt8[np.ndarray, "P 3"] | None = None
    uv: Float[np.ndarray, "P 2"] | None = None
    texture: UInt8[np.ndarray, "h w 3"] | None = None

    def __post_init__(self) -> None:
        count = len(self.vertices)
        if self.faces.min() < 0 or self.faces.max() >= count:
            raise InputError(f"faces: indices {self.faces.min()}..{self.faces.max()}; expected 0..{count - 1}")
        if self.texture is not None and self.uv is not None:
            if self.uv.shape != (count, 2):
                raise InputError(f"uv: got shape {self.uv.shape}; expected {(count, 2)}, one per vertex")
        elif self.colors is None or self.colors.shape != (count, 3) or self.colors.dtype != np.uint8:
            raise InputError(f"colors: expected uint8 of shape {(count, 3)}, or uv together with a texture")


@dataclass(frozen=True, eq=False)
class CornerNormals:
    """Normals at the three corners of every face: smooth over flat angles, broken at sharp edges of the rest shape."""

    sharing: sp.csr_matrix  # [3F, F]: which faces each corner averages over

    def at(self, corners: Float[np.ndarray, "F 3 3"]) -> Float[np.ndarray, "C 3"]:
        """Unit normals, shape [3F, 3], for the corner positions of each face."""
        area_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = self.sharing @ area_normals
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def corner_normals(
    vertices: Float[np.ndarray, "P 3"], faces: Int[np.ndarray, "F 3"], *, sharp_angle_deg: float = 45.0
) -> CornerNormals:
    """Choose for each corner the faces around its vertex that meet its own face under less than `sharp_angle_deg`."""
    count = len(faces)
    corner_vertex = sp.csr_matrix(
        (np.ones(3 * count), (np.arange(3 * count), faces.ravel())), shape=(3 * count, len(vertices))
    )
    vertex_face = sp.csr_matrix(
        (np.ones(3 * count), (faces.ravel(), np.repeat(np.arange(count), 3))), shape=(len(vertices), count)
    )
    pairs = (corner_vertex @ vertex_face).tocoo()
    x = vertices[faces]
    normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    own = pairs.row // 3
    cosine = np.einsum("ij,ij->i", normals[own], normals[pairs.col])
    keep = (cosine > np.cos(np.deg2rad(sharp_angle_deg))) | (own == pairs.col)
    weights = np.ones(int(keep.sum()))
    return CornerNormals(sp.csr_matrix((weights, (pairs.row[keep], pairs.col[keep])), shape=(3 * count, count)))


@dataclass(frozen=True)
class Lighting:
    """One key light far away, a fill light from the other side, ambient light and the floor's reflection.

    Attributes:
        direction: unit vector from the scene to the key light, shape [3], z > 0.
        key, fill, ambient: intensities, factors on the texture colour.
        color: RGB factor of the key light.
        specular: strength of the highlight.
        bounce: light from straight below, a factor on `ambient`.
        shadow_softness: standard deviation of the shadow's edge, in image heights.
    """

    direction: tuple[float, float, float]
    key: float = 0.8
    fill: float = 0.25
    ambient: float = 0.35
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    specular: float = 0.1
    shadow_softness: float = 0.01
    bounce: float = 0.5


@dataclass(frozen=True, eq=False)
class Backdrop:
    """Floor (plane z = 0) and background.

    Attributes:
        floor: texture, shape [h, w, 3] uint8, one tile of edge `floor_tile` [m].
        background: picture of the far surroundings, shape [h, w, 3] uint8 (row 0 is up).
    """

    floor: UInt8[np.ndarray, "h w 3"]
    background: UInt8[np.ndarray, "h2 w2 3"]
    floor_tile: float = 1.0
