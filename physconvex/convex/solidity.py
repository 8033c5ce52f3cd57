"""Solid region of convexes: membership of points in the union of the hulls, its samples, occupancy of that union."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from physconvex.convex.field import ConvexField, numbers
from physconvex.convex.halfspaces import HalfSpaces, half_spaces
from physconvex.errors import InputError
from physconvex.fem import SurfacePoints
from physconvex.reduced import BodySamples, Cubature, Shell

PAIRS = 400_000  # point-convex pairs evaluated at once
LARGEST = (30, 300, 2000)  # convexes tested, one set after the other
SOFT_REACH = 8.0  # an edge is neglected beyond this many widths 1/(αβ)


def inside_union(
    field: ConvexField, positions: Float[np.ndarray, "Q 3"], *, margin: float = 0.0, spaces: HalfSpaces | None = None
) -> Bool[np.ndarray, " Q"]:
    """Whether positions [m] lie in at least one hull, or no farther than `margin` [m] from its planes."""
    field = field.to(torch.float64)
    spaces = half_spaces(field) if spaces is None else spaces
    corners = field.points.detach()
    size = (corners.amax(dim=1) - corners.amin(dim=1)).prod(dim=1).numpy()
    order = np.argsort(-size, kind="stable")  # the largest first: points inside them need no further tests
    left = np.arange(len(positions))
    for block in np.split(order, [b for b in LARGEST if b < len(order)]):
        chosen = torch.as_tensor(block)
        some = HalfSpaces(spaces.normals[chosen], spaces.offsets[chosen])
        found = np.zeros(len(left), dtype=bool)
        for points, _, distances in _pairs(field.select(chosen), some, positions[left], np.full(len(block), margin)):
            found[points[distances.amax(dim=1).numpy() <= margin]] = True
        left = left[~found]
        if not len(left):
            break
    outside = np.zeros(len(positions), dtype=bool)
    outside[left] = True
    return ~outside


def union_volume(field: ConvexField, *, cells: int = 64) -> float:
    """Volume of the union of the hulls [m³], counted over the centres of cells³ boxes (about 0.1 % at 64)."""
    points = numbers(field.points).reshape(-1, 3)
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    ticks = (np.arange(cells) + 0.5) / cells
    grid = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    return float(inside_union(field, low + extent * grid).mean() * extent.prod())


def union_samples(
    field: ConvexField | None, surface: trimesh.Trimesh, *, cells: int = 80, interior: int = 1000, contacts: int = 300
) -> BodySamples:
    """Samples of the solid that a field's hulls fill within the closed surface of the body, without a mesh.

    Soft edges reach beyond the surface, so that it bounds the solid; overlaps count once. Membership is tested at the
    centres of a lattice, of `cells` along the longest edge; half a box from a hull counts, which closes gaps that are
    narrower than the lattice. The centres integrate the mass. The energy is integrated over the
    means of the centres within the boxes of a coarser lattice, each with their volume. Contact acts on the surface.

    Args:
        field: convexes at rest [m]; None takes all of the surface's inside, for convexes without a volume.
        surface: closed, outward faces [m].
        interior: about how many samples integrate the energy.
        contacts: about how many points of the surface can touch.

    Raises:
        InputError: the hulls fill nothing of the surface's inside.
    """
    low, extent = surface.bounds[0], np.ptp(surface.bounds, axis=0)
    edge = float(extent.max()) / cells
    ticks = [low[k] + edge * (np.arange(int(np.ceil(extent[k] / edge))) + 0.5) for k in range(3)]
    points = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    points = points[np.asarray(surface.contains(points))]
    if field is not None and len(points):
        points = points[inside_union(field, points, margin=0.5 * edge)]
    if len(points) < 8:
        raise InputError(
            f"field: its hulls fill {len(points)} of the {cells}³ boxes inside the surface; expected the field of this "
            "body, in the same frame, with convexes that have a volume"
        )
    coarse = edge * (len(points) / min(interior, len(points))) ** (1 / 3)
    _, owners = np.unique(np.floor((points - low) / coarse).astype(np.int64), axis=0, return_inverse=True)
    owners = owners.ravel()
    counts = np.bincount(owners)
    means = np.stack([np.bincount(owners, points[:, k]) for k in range(3)], axis=1) / counts[:, None]
    touching = SurfacePoints.of_triangles(np.asarray(surface.vertices), np.asarray(surface.faces), count=contacts)
    return BodySamples(
        interior=Cubature(means, counts * edge**3, np.arange(len(means)), len(means)),
        mass=Cubature(points, np.full(len(points), edge**3), owners, len(means)),
        surface_points=touching.points,
        surface_areas=touching.areas,
        shell=Shell(np.asarray(surface.vertices), np.asarray(surface.faces)),
    )


def occupancies(
    field: ConvexField, positions: Float[np.ndarray, "Q 3"], *, spaces: HalfSpaces | None = None
) -> tuple[Float[np.ndarray, " Q"], Float[np.ndarray, " Q"]]:
    """max_i opacity_i O_i and 1 − Π_i (1 − opacity_i O_i) at positions [m], with O_i of `ConvexField`."""
    field = field.to(torch.float64)
    spaces = half_spaces(field) if spaces is None else spaces
    greatest, free = np.zeros(len(positions)), np.ones(len(positions))
    reach = (SOFT_REACH / (field.smoothness * field.sharpness)).detach().numpy()
    for points, convexes, distances in _pairs(field, spaces, positions, reach):
        scaled = field.smoothness[convexes, None] * distances
        inside = torch.sigmoid(-field.sharpness[convexes] * torch.logsumexp(scaled, dim=1))
        opaque = (field.opacity[convexes] * inside).detach().numpy()
        np.maximum.at(greatest, points, opaque)
        np.multiply.at(free, points, 1 - opaque)
    return greatest, 1 - free


def _pairs(
    field: ConvexField, spaces: HalfSpaces, positions: np.ndarray, reach: np.ndarray
) -> Iterator[tuple[np.ndarray, torch.Tensor, torch.Tensor]]:
    """Points, convexes and distances [pairs, H] to their planes, of pairs whose bounding balls and boxes may meet."""
    tree = cKDTree(positions)
    centres, corners = field.centres.detach(), field.points.detach().numpy()
    low, high = corners.min(axis=1) - reach[:, None], corners.max(axis=1) + reach[:, None]
    radius = torch.linalg.vector_norm(field.points.detach() - centres[:, None], dim=2).amax(dim=1).numpy() + reach
    for block in np.array_split(np.arange(len(field)), max(1, len(field) // 2000)):
        near = tree.query_ball_point(centres[block].numpy(), radius[block])
        owners = np.repeat(block, [len(some) for some in near])
        points = np.concatenate([np.asarray(some, dtype=np.int64) for some in near])
        meet = ((positions[points] >= low[owners]) & (positions[points] <= high[owners])).all(axis=1)
        owners, points = owners[meet], points[meet]
        for part in np.array_split(np.arange(len(points)), 1 + len(points) // PAIRS):
            if len(part):
                convexes = torch.as_tensor(owners[part])
                where = torch.as_tensor(positions[points[part]])
                distances = torch.einsum("pi,phi->ph", where, spaces.normals[convexes].detach())
                yield points[part], convexes, distances - spaces.offsets[convexes].detach()
