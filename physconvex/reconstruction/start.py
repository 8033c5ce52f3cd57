"""The field that a reconstruction starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from scipy.spatial import cKDTree

from physconvex.convex import ConvexField, coefficients_of_colour
from physconvex.errors import InputError
from physconvex.reconstruction.carving import footprint
from physconvex.reconstruction.config import ReconstructionConfig, StartKind
from physconvex.reconstruction.first_convexes import UNPAINTED, fillers, octahedra, prisms, with_count
from physconvex.reconstruction.hull_surface import visual_hull
from physconvex.reconstruction.observation import Gathered, Observation, gather
from physconvex.reconstruction.triangles import even_triangles, welded

FLAT = 3  # points of a convex that fills nothing
OPACITY = 0.97
DEPTH = 1.3  # of prisms, in mean edges of the triangles


@dataclass(frozen=True, eq=False)
class Start:
    """The field before optimisation.

    Attributes:
        field: the convexes, the fillers last.
        fillers: how many of them fill the inside; they are fixed and not drawn.
        footprint: size of a pixel at the object [m].
        kind: source of the convexes.
    """

    field: ConvexField
    fillers: int
    footprint: float
    kind: StartKind


def start_field(
    observations: Sequence[Observation],
    config: ReconstructionConfig,
    *,
    mesh: trimesh.Trimesh | None = None,
    points: Float[np.ndarray, "P 3"] | None = None,
) -> Start:
    """Convexes from the object's surface (`mesh`, else the visual hull) or from points [m], coloured by the views.

    Raises:
        InputError: the source in `config.start` is not given, or the views contradict each other.
    """
    kind = start_kind(config.start, mesh=mesh is not None, points=points is not None)
    pixel = footprint(observations)
    inner = np.zeros((0, 6, 3))
    if kind == "points":
        assert points is not None
        outer = octahedra(_thinned(points, round(config.start_share * config.fit_budget), config.seed))
    else:
        surface = body_surface(kind, observations, mesh)
        assert surface is not None
        triangles = even_triangles(surface, max(4, round(config.start_share * config.fit_budget)))
        depth = DEPTH * float(np.sqrt(4 / np.sqrt(3) * triangles.areas.mean()))
        outer = prisms(triangles, surface, depth=depth, overhang=0.5 * config.edge_width * pixel)
        if config.points_per_convex > FLAT:
            inner = fillers(surface, depth=depth, most=round(config.filler_share * config.fit_budget))
    hulls = with_count(np.concatenate([outer, inner]), config.points_per_convex)
    both = torch.as_tensor(hulls, dtype=torch.float32)
    ones = torch.ones(len(both))
    grey = coefficients_of_colour(torch.full((len(both), 3), 0.5))
    opacity = torch.where(torch.arange(len(both)) < len(outer), OPACITY, UNPAINTED)
    field = ConvexField(both, ones * 4 / (config.edge_width * pixel), ones, opacity, grey)
    return Start(_coloured(field, observations), len(inner), pixel, kind)


def body_surface(
    kind: StartKind, observations: Sequence[Observation], mesh: trimesh.Trimesh | None
) -> trimesh.Trimesh | None:
    """The surface for a kind of start; None for points."""
    if kind == "points":
        return None
    return welded(mesh) if kind == "mesh" and mesh is not None else visual_hull(observations)


def start_kind(asked: StartKind, *, mesh: bool, points: bool) -> StartKind:
    """The kind of start, given whether there are a mesh and points.

    Raises:
        InputError: the requested source is not given.
    """
    if asked == "mesh" and not mesh:
        raise InputError("start: got 'mesh', but the capture holds none; add mesh.obj, or use 'hull' or 'auto'")
    if asked == "points" and not points:
        raise InputError("start: got 'points', but none are given; name a file of them, or use 'hull' or 'auto'")
    if asked != "auto":
        return asked
    return "mesh" if mesh else "points" if points else "hull"


def _thinned(points: np.ndarray, most: int, seed: int) -> np.ndarray:
    """At most that many of the points, at random."""
    points = np.unique(np.asarray(points, dtype=np.float64), axis=0)
    if points.shape[1:] != (3,) or len(points) < 4 or not np.isfinite(points).all():
        raise InputError(f"points: got shape {points.shape} of different ones; expected finite [P, 3] with P ≥ 4")
    if len(points) <= most:
        return points
    return points[np.random.default_rng(seed).choice(len(points), most, replace=False)]


def _coloured(field: ConvexField, observations: Sequence[Observation]) -> ConvexField:
    """Each convex in the mean colour of the pixels it explains, invisible ones in that of the nearest visible one."""
    total = Gathered(torch.zeros(len(field)), torch.zeros(len(field), 3))
    for seen in observations:
        found = gather(field, seen.view, seen.image * seen.coverage[..., None])
        share = gather(field, seen.view, seen.coverage[..., None].expand(-1, -1, 3))
        total = Gathered(total.weights + share.values[:, 0], total.values + found.values)
    colours = total.means(torch.full((3,), 0.5))
    known = total.weights > 0.05
    if known.any() and not known.all():
        count = min(4, int(known.sum()))
        near = cKDTree(field.centres[known].numpy()).query(field.centres[~known].numpy(), k=[*range(1, count + 1)])[1]
        colours[~known] = colours[known][torch.as_tensor(near)].mean(dim=1)
    return replace(field, harmonics=coefficients_of_colour(colours))
