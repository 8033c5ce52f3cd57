"""A texture for the body's surface: charts laid out in a square, whose texels get the colours of the pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
import xatlas
from jaxtyping import Float, Int
from PIL import Image
from scipy.ndimage import distance_transform_edt

from physconvex.reconstruction.carving import cell_of
from physconvex.reconstruction.observation import Observation
from physconvex.reconstruction.photo_consistency import colour_sums

SIZE = 1024  # texels along an edge
APART = 2  # texels between charts, when they are laid out
RIM = 0.01  # barycentric: texels of a chart's rim


def textured(surface: trimesh.Trimesh, observations: Sequence[Observation], *, size: int = SIZE) -> trimesh.Trimesh:
    """The surface with a texture, cut along the seams of its charts: vertices there are double, their places equal.

    A texel's colour is the mean over the views that show its place, by the squared cosine between normal and ray; where
    none shows it, that of the vertices.

    Args:
        surface: closed, with a colour per vertex [m].
        observations: the views, on the CPU.
        size: texels along an edge of the square.
    """
    assert isinstance(surface.visual, trimesh.visual.ColorVisuals)
    kept, faces, places = _layout(surface)
    rows, columns, owners, weights = _texels(size * places[faces])
    corners = kept[faces[owners]]
    positions, normals, colours = (
        np.einsum("tk,tki->ti", weights, np.asarray(values, dtype=np.float64)[corners])
        for values in (surface.vertices, surface.vertex_normals, surface.visual.vertex_colors[:, :3] / 255)
    )
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    total, weight = colour_sums(surface, observations, (positions, normals), cell=cell_of(observations))
    seen = weight > 0
    colours[seen] = total[seen] / weight[seen, None]
    picture, empty = np.zeros((size, size, 3)), np.ones((size, size), dtype=bool)
    picture[rows, columns], empty[rows, columns] = colours, False
    nearest = distance_transform_edt(empty, return_distances=False, return_indices=True)
    image = Image.fromarray((255 * picture[tuple(nearest)].clip(0, 1)).round().astype(np.uint8))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image, metallicFactor=0.0, roughnessFactor=1.0)
    flipped = np.stack([places[:, 0], 1 - places[:, 1]], axis=1)  # rows count from the top
    return trimesh.Trimesh(
        np.asarray(surface.vertices)[kept],
        faces,
        process=False,
        visual=trimesh.visual.TextureVisuals(uv=flipped, material=material),
    )


def _layout(
    surface: trimesh.Trimesh,
) -> tuple[Int[np.ndarray, " U"], Int[np.ndarray, "F 3"], Float[np.ndarray, "U 2"]]:
    """Charts in a unit square: the vertex that each of theirs was, triangles, places (column, row)."""
    atlas, options = xatlas.Atlas(), xatlas.PackOptions()
    atlas.add_mesh(np.asarray(surface.vertices, dtype=np.float32), np.asarray(surface.faces, dtype=np.uint32))
    options.padding = APART
    atlas.generate(pack_options=options)
    kept, faces, places = atlas.get_mesh(0)
    return kept.astype(np.int64), faces.astype(np.int64), places.astype(np.float64)


def _texels(
    triangles: Float[np.ndarray, "F 3 2"],
) -> tuple[Int[np.ndarray, " T"], Int[np.ndarray, " T"], Int[np.ndarray, " T"], Float[np.ndarray, "T 3"]]:
    """Row, column, triangle and barycentric coordinates of all texels whose centres lie in a triangle."""
    low = np.floor(triangles.min(axis=1)).astype(np.int64)
    spans = np.ceil(triangles.max(axis=1)).astype(np.int64) - low
    counts = spans.prod(axis=1)
    owners = np.repeat(np.arange(len(triangles)), counts)
    number = np.arange(len(owners)) - np.repeat(np.cumsum(counts) - counts, counts)
    wide = spans[owners, 0]
    columns, rows = low[owners, 0] + number % wide, low[owners, 1] + number // wide
    edges = triangles[:, 1:] - triangles[:, :1]
    area = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    away = np.stack([columns, rows], axis=1) + 0.5 - triangles[owners, 0]
    first, second = edges[owners, 0], edges[owners, 1]
    with np.errstate(divide="ignore", invalid="ignore"):  # flat triangles have no texels
        along = (away[:, 0] * second[:, 1] - away[:, 1] * second[:, 0]) / area[owners]
        across = (first[:, 0] * away[:, 1] - first[:, 1] * away[:, 0]) / area[owners]
        weights = np.stack([1 - along - across, along, across], axis=1)
        inside = weights.min(axis=1) >= -RIM
    return rows[inside], columns[inside], owners[inside], weights[inside]
