"""How far a surface made from pictures may be from the body's.

Three parts, measured on scanned objects (`benchmarks/body_error.py`, docs/results/body_from_pictures.md): an offset
that the whole surface shares, errors that change within a twentieth of the size, and, where fewer than two pictures
show it, an error of that whole part, which grows with the distance from what two pictures show. Where much of the
surface has other colours in every picture, the body may be hollow there, where no silhouette tells it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from physconvex.reconstruction.carving import cell_of
from physconvex.reconstruction.observation import Observation
from physconvex.reconstruction.photo_consistency import AGREE, colour_spread, cosines_shown

COMMON, VIEWS = 0.13, 12  # cells: the shared offset with so many views; it falls with the root of their number
LOCAL, LENGTH = 0.6, 0.03  # cells; of the size: their correlation is exp(−½) at that distance
UNSEEN, AWAY = 1.0, 0.2  # cells; share of the distance from what two pictures show
CONTESTED, MUCH, HOLLOW = 0.15, 0.05, 0.5  # spread of colours; least share of the area; of the thickness there
_WAVES = 256  # of a random error


@dataclass(frozen=True, eq=False)
class SurfaceError:
    """Standard deviations of a surface's place along its outward normals [m].

    Attributes:
        views: number of pictures that show each vertex, shape [V].
        areas: area of the surface that each vertex represents [m²], shape [V].
        common: of an offset of all vertices.
        local: of what varies from place to place.
        unseen: of the part that fewer than two pictures show, and of what is contested, by vertex, shape [V]; zero
            elsewhere.
        length: distance at which the correlation of local errors is exp(−½) [m].
        contested_share: share of the area whose colours differ from picture to picture; zero if it is small.
    """

    views: Int[np.ndarray, " V"]
    areas: Float[np.ndarray, " V"]
    common: float
    local: float
    unseen: Float[np.ndarray, " V"]
    length: float
    contested_share: float = 0.0

    @property
    def unseen_share(self) -> float:
        """Share of the area that fewer than two pictures show."""
        return float(self.areas[self.views < AGREE].sum() / self.areas.sum())

    @property
    def deviation(self) -> float:
        """Root of the variance's mean over the surface [m]."""
        unseen = float(self.areas @ np.square(self.unseen) / self.areas.sum())
        return float(np.sqrt(self.common**2 + self.local**2 + unseen))

    def displacements(
        self, vertices: Float[np.ndarray, "V 3"], *, draws: int, generator: np.random.Generator
    ) -> tuple[tuple[float, Float[np.ndarray, " V"]], ...]:
        """Independent displacements of one standard deviation along the normals [m], each with its weight.

        The variance of what depends linearly on the surface is the sum of its squared changes, times the weights: by
        the shared offset, by the unseen part if there is one, and by the mean over `draws` of local errors.
        """
        out = [(1.0, np.full(len(self.views), self.common))]
        if self.unseen.any():
            out.append((1.0, self.unseen))
        for _ in range(draws):
            out.append((1.0 / draws, self.local * _random_field(vertices, self.length, generator)))
        return tuple(out)


def surface_error(surface: trimesh.Trimesh, observations: Sequence[Observation]) -> SurfaceError:
    """The error of a closed surface found by `closed_surface` from these observations."""
    cell, vertices = cell_of(observations), np.asarray(surface.vertices, dtype=np.float64)
    areas = vertex_areas(surface)
    cosines = cosines_shown(surface, observations, cell=cell)
    views = (cosines > 0).sum(axis=1)
    known = views >= AGREE
    far = cKDTree(vertices[known]).query(vertices)[0] if known.any() else np.full(len(vertices), np.inf)
    far = np.minimum(far, float(surface.extents.max()))
    unseen = np.where(known, 0.0, np.hypot(UNSEEN * cell, AWAY * far))
    contested = contested_places(surface, observations, cosines)
    share = float(areas[contested].sum() / areas.sum())
    if share > MUCH:
        unseen[contested] = np.maximum(unseen[contested], HOLLOW * _thickness(surface, contested))
    common = COMMON * cell * float(np.sqrt(VIEWS / len(observations)))
    return SurfaceError(
        views,
        areas,
        common,
        LOCAL * cell,
        unseen,
        LENGTH * float(surface.extents.max()),
        share if share > MUCH else 0.0,
    )


def vertex_areas(surface: trimesh.Trimesh) -> Float[np.ndarray, " V"]:
    """Area of the surface that each vertex represents [m²]."""
    areas = np.zeros(len(surface.vertices))
    np.add.at(areas, surface.faces, surface.area_faces[:, None] / 3)
    return areas


def contested_places(
    surface: trimesh.Trimesh, observations: Sequence[Observation], cosines: Float[np.ndarray, "V C"]
) -> Bool[np.ndarray, " V"]:
    """Vertices whose colours differ from picture to picture: they shine, or pictures look into a hollow there."""
    return colour_spread(surface, observations, cosines) > CONTESTED


def _thickness(surface: trimesh.Trimesh, chosen: Bool[np.ndarray, " V"]) -> Float[np.ndarray, " C"]:
    """Distance from vertices through the body to its other side [m]."""
    inward = -np.asarray(surface.vertex_normals)[chosen]
    begin = np.asarray(surface.vertices)[chosen] + 1e-4 * surface.scale * inward
    places, rays, _ = surface.ray.intersects_location(begin, inward, multiple_hits=False)
    out = np.zeros(len(begin))
    out[rays] = np.linalg.norm(places - begin[rays], axis=1)
    return out


def _random_field(
    positions: Float[np.ndarray, "V 3"], length: float, generator: np.random.Generator
) -> Float[np.ndarray, " V"]:
    """A Gaussian random field of variance 1, correlation exp(−½ r²/length²): a sum of waves (Rahimi & Recht 2007)."""
    waves = generator.normal(scale=1 / length, size=(3, _WAVES))
    phases = generator.uniform(0, 2 * np.pi, size=_WAVES)
    return np.sqrt(2.0 / _WAVES) * np.cos(positions @ waves + phases).sum(axis=1)
