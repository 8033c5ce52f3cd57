"""A hollow that no silhouette shows, such as that of a mug: a wall of one thickness around it.

Where pictures look into a hollow, the visual hull has a lid, whose colours differ from picture to picture. The body is
cut out under the lid, up to a distance from all other surfaces: the wall's thickness, at which the pictures agree best
about the pattern of the inside. What none of them shows of it has the same thickness. If its colours differ from
picture to picture too, it was no lid: the body shines there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.ndimage import label
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from physconvex.reconstruction.carving import cell_of, cube_lattice, object_box
from physconvex.reconstruction.hull_surface import level_surface
from physconvex.reconstruction.observation import Observation
from physconvex.reconstruction.photo_consistency import (
    AGREE,
    colours_apart,
    colours_seen,
    cosines_shown,
    patterns_apart,
)
from physconvex.reconstruction.surface_errors import MUCH, contested_places, vertex_areas

LEVEL = 0.7  # least cosine between the normals of a rim and of its lid
THINNEST, THICKER = 1.5, 1.25  # thickness of the wall: the least [cells], and the factor between two that are tried
WORSE = 1.15  # disagreement, of the least so far, beyond which no thicker wall is tried
LEAST_HOLLOW = 0.05  # of the volume: smaller ones are not looked for
AGREED = 0.5  # most disagreement of the pictures about the colours of the inside, of that about the lid
ABOVE = 3.0  # cells by which the cut begins outside the lid
EVENED = 10  # steps of Taubin's filter on the inside


@dataclass(frozen=True, eq=False)
class Hollow:
    """A body with a hollow.

    Attributes:
        surface: closed, outward oriented [m], with a colour per vertex.
        thickness: of the wall around the hollow [m].
        share: of the filled volume that is hollow.
    """

    surface: trimesh.Trimesh
    thickness: float
    share: float


def find_hollow(surface: trimesh.Trimesh, observations: Sequence[Observation]) -> Hollow | None:
    """The hollow behind the largest part of a surface whose colours differ from picture to picture.

    None if there is no such part, or if no thickness of a wall explains its colours: then it may shine.

    Args:
        surface: of the filled body, from `closed_surface` [m].
        observations: the views that it is made from, on the CPU.
    """
    cell = cell_of(observations)
    cosines = cosines_shown(surface, observations, cell=cell)
    lid = _largest_part(surface, contested_places(surface, observations, cosines))
    areas = vertex_areas(surface)
    if areas[lid].sum() < MUCH * areas.sum():
        return None
    cut, outer = _Cut.through(surface, lid, observations, cell), cKDTree(surface.vertices)

    def inside_of(hollow: trimesh.Trimesh) -> _Shown:
        inside = outer.query(hollow.vertices, distance_upper_bound=0.5 * cell)[0] == np.inf
        return _Shown.of(hollow, inside, observations, cosines_shown(hollow, observations, cell=cell))

    tried: dict[float, float] = {}
    thickness = THINNEST * cell
    while (hollow := cut.at(thickness)) is not None:
        tried[thickness] = inside_of(hollow).patterns_disagree()
        if tried[thickness] > WORSE * min(tried.values()):
            break
        thickness *= THICKER
    thickness = _least(tried)
    found = cut.at(thickness)
    if found is None:
        return None
    most = AGREED * _Shown.of(surface, lid, observations, cosines).colours_disagree()
    if not inside_of(found).colours_disagree() < most:
        return None
    colours = colours_seen(found, observations, cell=cell)
    found.visual = trimesh.visual.ColorVisuals(found, vertex_colors=colours)
    return Hollow(found, thickness, 1 - found.volume / surface.volume)


@dataclass(frozen=True, eq=False)
class _Cut:
    """What is cut out of a body, on a lattice.

    Attributes:
        surface: of the filled body [m].
        away: distance of the points from the wall [m], shape [n, n, n]; negative where nothing is cut.
        above: the points outside the lid, shape [n, n, n].
        origin, cell: place of the first point, and distance between neighbours [m].
    """

    surface: trimesh.Trimesh
    away: Float[np.ndarray, "n n n"]
    above: Bool[np.ndarray, "n n n"]
    origin: Float[np.ndarray, " 3"]
    cell: float

    @classmethod
    def through(
        cls, surface: trimesh.Trimesh, lid: Bool[np.ndarray, " V"], observations: Sequence[Observation], cell: float
    ) -> _Cut:
        """Through a lid and the level rim around it; all other surface is wall."""
        vertices, normals = np.asarray(surface.vertices), np.asarray(surface.vertex_normals)
        outward = vertex_areas(surface)[lid] @ normals[lid]
        outward /= max(float(np.linalg.norm(outward)), 1e-12)
        mouth = _part_around(surface, lid | (normals @ outward > LEVEL), lid)
        mouth = ~_largest_part(surface, ~mouth)  # with the bumps of the lid
        centre, half = object_box(observations)
        cells = round(2 * half / cell)
        lattice, cell = cube_lattice(centre, half, cells)
        low, high = surface.bounds
        near = np.nonzero(((lattice > low - ABOVE * cell) & (lattice < high + ABOVE * cell)).all(axis=1))[0]
        inside = surface.contains(lattice[near])
        nearest = cKDTree(vertices).query(lattice[near], distance_upper_bound=ABOVE * cell)[1]
        above = ~inside & np.append(mouth, False)[nearest]  # beyond that distance none is the nearest
        away, outside = np.full(len(lattice), -cell), np.zeros(len(lattice), dtype=bool)
        open_ = inside | above
        away[near[open_]] = cKDTree(vertices[~mouth]).query(lattice[near[open_]])[0]
        outside[near[above]] = True
        shape = (cells + 1,) * 3
        return cls(surface, away.reshape(shape), outside.reshape(shape), centre - half, cell)

    def at(self, thickness: float) -> trimesh.Trimesh | None:
        """The body with a wall of that thickness [m]; None if hardly anything is cut."""
        parts, _ = label(self.away > thickness)
        reached = np.isin(parts, np.setdiff1d(parts[self.above], 0))
        if (reached & ~self.above).sum() * self.cell**3 < LEAST_HOLLOW * self.surface.volume:
            return None
        beyond = np.where(reached | (parts == 0), thickness - self.away, self.cell)
        tool = level_surface(np.clip(beyond, -self.cell, self.cell), origin=self.origin, cell=self.cell)
        tool = trimesh.smoothing.filter_taubin(tool, iterations=EVENED)
        left = trimesh.boolean.difference([self.surface, tool], engine="manifold").split()
        return max(left, key=lambda part: part.volume, default=None)


def _largest_part(surface: trimesh.Trimesh, chosen: Bool[np.ndarray, " V"]) -> Bool[np.ndarray, " V"]:
    """The largest connected part of chosen vertices."""
    parts = _parts(surface, chosen)
    sizes = np.bincount(parts[chosen], minlength=1)
    return chosen & (parts == sizes.argmax())


def _part_around(
    surface: trimesh.Trimesh, chosen: Bool[np.ndarray, " V"], inner: Bool[np.ndarray, " V"]
) -> Bool[np.ndarray, " V"]:
    """The connected part of chosen vertices that holds others."""
    parts = _parts(surface, chosen)
    return chosen & (parts == parts[np.argmax(inner)])


def _parts(surface: trimesh.Trimesh, chosen: Bool[np.ndarray, " V"]) -> Int[np.ndarray, " V"]:
    edges = surface.edges_unique[chosen[surface.edges_unique].all(axis=1)]
    links = csr_matrix((np.ones(len(edges)), edges.T), (len(chosen), len(chosen)))
    return connected_components(links, directed=False)[1]


@dataclass(frozen=True, eq=False)
class _Shown:
    """Vertices that several views show.

    Attributes:
        places, normals: shape [Q, 3], [m] and unit vectors.
        observations: the views.
        cosines: of `cosines_shown`, shape [Q, C].
        pixels: of each vertex in each view, but for a factor, shape [Q, C].
    """

    places: Float[np.ndarray, "Q 3"]
    normals: Float[np.ndarray, "Q 3"]
    observations: Sequence[Observation]
    cosines: Float[np.ndarray, "Q C"]
    pixels: Float[np.ndarray, "Q C"]

    @classmethod
    def of(
        cls,
        surface: trimesh.Trimesh,
        chosen: Bool[np.ndarray, " V"],
        observations: Sequence[Observation],
        cosines: Float[np.ndarray, "V C"],
    ) -> _Shown:
        """Those of the chosen ones."""
        rows = chosen & ((cosines > 0).sum(axis=1) >= AGREE)
        places, normals = np.asarray(surface.vertices)[rows], np.asarray(surface.vertex_normals)[rows]
        return cls(places, normals, observations, cosines[rows], vertex_areas(surface)[rows, None] * cosines[rows])

    def colours_disagree(self) -> float:
        """Mean distance of the colours from their mean, over all pixels; infinite if nothing is shown."""
        if not len(self.places):
            return np.inf
        apart = colours_apart(self.places, self.observations, self.cosines)
        return float((self.pixels * apart).sum() / self.pixels.sum())

    def patterns_disagree(self) -> float:
        """Share of the pattern that the views do not have in common, over all pixels; infinite if nothing is shown."""
        if not len(self.places):
            return np.inf
        apart, size = patterns_apart((self.places, self.normals), self.observations, self.cosines)
        return float((self.pixels * apart).sum() / max((self.pixels * size).sum(), 1e-12))


def _least(tried: dict[float, float]) -> float:
    """The minimum of a parabola through the least value of a function and its neighbours; infinite if there is none."""
    places, values = np.array(list(tried)), np.array(list(tried.values()))
    if not np.isfinite(values).any():
        return np.inf
    best = int(np.argmin(values))
    around = slice(max(best - 1, 0), best + 2)
    if len(values[around]) < 3 or not np.isfinite(values[around]).all():
        return float(places[best])
    steps = np.log(places[around] / places[best])
    curvature, slope, _ = np.polyfit(steps, values[around], 2)
    return float(places[best] * np.exp(np.clip(-slope / (2 * curvature), steps[0], steps[-1])))
