"""Convex dynamics: splits convexes, and merges them again, as the deformation requires."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from physconvex.convex.field import LEAST_POINTS, ConvexField, numbers
from physconvex.convex.hull_points import LEAST_SOLID, cut_points, fewer_points, hull_volume, padded_points
from physconvex.convex.motion import DeformationMap
from physconvex.errors import InputError

LEVELS = 6  # most splits: one convex becomes up to 64
POINTS = 50_000  # at which a deformation is evaluated at once: with all states it takes kilobytes at each
MOST_OVERLAP = 0.2  # of the extent across the cut
CENTRAL = 0.15  # a corner this near to the middle (in extents) is the place of the cut
NEAR_CUT, CENTRAL_POINT = 0.05, 0.3  # of `halve`: points this near to the cut belong to both parts; as CENTRAL


@dataclass(frozen=True, eq=False)
class Division:
    """Result of splitting or merging.

    Attributes:
        field: the new field.
        sources: for each new convex the old one that contains it, shape [M].
        lost_volume: volume of the old hulls outside every new hull, since a hull has at most K points [m³].
    """

    field: ConvexField
    sources: Int[Tensor, " M"]
    lost_volume: float


def non_affinity(field: ConvexField, deform: DeformationMap) -> Float[Tensor, " N"]:
    """Deviation of a deformation from an affine map within each convex, relative to the size of the moved convex.

    The greatest distance of the moved points, and of the moved middles of all pairs of points, from their images under
    the best affine map (least squares over them), divided by the greatest distance of two moved points. Of several
    states the greatest.
    """
    deviation, size = deviation_from_affine(field, deform)
    return (deviation / size).amax(dim=0)


def deviation_from_affine(
    field: ConvexField, deform: DeformationMap
) -> tuple[Float[Tensor, "T N"], Float[Tensor, "T N"]]:
    """The greatest distance from the best affine map, and the size of the moved convex [m], see `non_affinity`."""
    count = field.points.shape[1]
    blocks = [_deviation(field.select(rows), deform) for rows in _blocks(field, count * (count + 1) // 2)]
    deviations, sizes = zip(*blocks, strict=True)
    return torch.cat(deviations, dim=1), torch.cat(sizes, dim=1)


def _blocks(field: ConvexField, points: int) -> tuple[Tensor, ...]:
    """Indices of the convexes in parts, with so many points in each convex."""
    return torch.arange(len(field)).split(max(1, POINTS // points))


def _deviation(field: ConvexField, deform: DeformationMap) -> tuple[Float[Tensor, "T N"], Float[Tensor, "T N"]]:
    first, second = zip(*combinations(range(field.points.shape[1]), 2), strict=True)
    rest = torch.cat([field.points, 0.5 * (field.points[:, first] + field.points[:, second])], dim=1)
    moved = deform(rest.reshape(-1, 3))[0].reshape(-1, *rest.shape)
    ones = torch.ones_like(rest[..., :1])
    scale = torch.linalg.vector_norm(rest - rest.mean(dim=1, keepdim=True), dim=2).mean(dim=1)[:, None, None]
    table = torch.cat([(rest - rest.mean(dim=1, keepdim=True)) / scale, ones], dim=2)
    fitted = table @ (torch.linalg.pinv(table) @ moved)
    corners = moved[:, :, : field.points.shape[1]]
    size = torch.cdist(corners, corners).flatten(2).amax(dim=2)
    return torch.linalg.vector_norm(moved - fitted, dim=3).amax(dim=2), size


def split(
    field: ConvexField,
    which: Bool[Tensor, " N"],
    *,
    normals: Float[Tensor, "N 3"] | None = None,
    overlap: Float[Tensor, " N"] | float = 0.0,
    keep_count: bool = True,
) -> Division:
    """Split convexes into two, by default across their longest extent; the others are unchanged and come first.

    The cut goes through the middle, or through a corner near it, which leaves fewer corners. Both parts keep colour,
    edges and opacity. Without `overlap` their hulls share one face: occupancy as a set is conserved exactly, but soft
    edges there transmit light. Flat convexes stay flat.

    Args:
        which: the convexes to split, shape [N].
        normals: of the cuts, shape [N, 3].
        overlap: reach of each part beyond the cut [m], one or per convex.
        keep_count: keep K points per convex, without the corners that cost the least volume; otherwise K grows so that
            all are kept.
    """
    if which.shape != (len(field),) or which.dtype != torch.bool:
        raise InputError(f"which: got {which.dtype} of shape {tuple(which.shape)}; expected bool [{len(field)}]")
    count = field.points.shape[1]
    margins = numbers(torch.as_tensor(overlap).expand(len(field)))
    chosen = which.nonzero()[:, 0]
    points = numbers(field.points)
    longest = np.linalg.svd(points - points.mean(axis=1, keepdims=True), full_matrices=False)[2][:, 0]
    directions = longest if normals is None else numbers(normals)
    parts: list[np.ndarray] = []
    lost = 0.0
    for convex in chosen.tolist():
        for part in _halves(points[convex], directions[convex], margins[convex]):
            kept = fewer_points(part, count) if keep_count else part
            lost += hull_volume(part) - hull_volume(kept) if len(kept) < len(part) else 0.0
            parts.append(kept)
    width = max([count, *map(len, parts)])
    sources = torch.cat([(~which).nonzero()[:, 0], chosen.repeat_interleave(2)])
    new = np.array([padded_points(part, width) for part in parts]).reshape(-1, width, 3)
    old = torch.cat([field.points, field.points[:, :1].expand(-1, width - count, -1)], dim=1)[~which]
    divided = field.select(sources).with_points(torch.cat([old, torch.as_tensor(new).to(old)]))
    return Division(divided, sources, lost)


def _halves(
    points: Float[np.ndarray, "K 3"], normal: Float[np.ndarray, " 3"], margin: float
) -> tuple[np.ndarray, np.ndarray]:
    """The parts on either side of the cut."""
    height = points @ normal
    low, high = height.min(), height.max()
    offset = 0.5 * (low + high)
    nearest = height[np.abs(height - offset).argmin()]
    if abs(nearest - offset) < CENTRAL * (high - low):
        offset = nearest
    halves = cut_points(points, normal, offset + margin), cut_points(points, -normal, -offset + margin)
    least = min(map(len, halves))
    return halves if least >= LEAST_POINTS else (points, points)


def split_until_affine(
    field: ConvexField,
    deform: DeformationMap,
    *,
    tolerance: float,
    limit: int,
    least: float = 0.0,
    overlap: float = 0.0,
) -> Division:
    """Split the rest field, across the direction in which the gradient changes most, until the deformation is
    affine within every convex up to `tolerance` in every state of the map, or there are `limit`.

    All corners are kept (K may grow), so that the union of the hulls is unchanged. Advect the result.

    Args:
        tolerance: greatest remaining `non_affinity`, as a share of a convex's size.
        limit: most convexes.
        least: smaller distances from affine remain [m], for example a part of a pixel. A map of finite elements has
            kinks at element faces, and a convex across a face stays as far from affine, relative to its size, after
            every split.
        overlap: reach of each part beyond the cut, in widths 1/(αβ) of its edge, at most a fifth of the way across;
            without it, light passes between soft parts.

    Raises:
        InputError: a tolerance that is not positive, a negative least distance or overlap.
    """
    if not tolerance > 0:
        raise InputError(f"tolerance: got {tolerance}; expected a positive share of a convex's size")
    if min(least, overlap) < 0:
        raise InputError(f"least, overlap: got {least} m and {overlap} widths of an edge; expected at least 0")
    sources, lost = torch.arange(len(field)), 0.0
    new = sources  # convexes that the last round made
    for _ in range(LEVELS):
        deviation, size = deviation_from_affine(field.select(new), deform)
        error = torch.where(deviation > least, deviation / size, 0.0).amax(dim=0).detach().cpu()
        worst = error.argsort(descending=True)[: max(limit - len(field), 0)]
        chosen = new[worst[error[worst] > tolerance]].sort().values
        if not len(chosen):
            break
        which = torch.zeros(len(field), dtype=torch.bool)
        which[chosen] = True
        normals = torch.zeros_like(field.points[:, 0])
        bent = field.select(chosen)
        normals[chosen] = torch.cat(
            [_bending(bent.select(rows), deform) for rows in _blocks(bent, bent.points.shape[1])]
        )
        heights = torch.einsum("nki,ni->nk", field.points.detach(), normals)
        across = heights.amax(dim=1) - heights.amin(dim=1)
        reach = torch.minimum(overlap / (field.smoothness * field.sharpness), MOST_OVERLAP * across).detach()
        division = split(field, which, normals=normals, overlap=reach, keep_count=False)
        field, sources, lost = division.field, sources[division.sources], lost + division.lost_volume
        new = torch.arange(len(field) - 2 * len(chosen), len(field))
    return Division(field, sources, lost)


def _bending(field: ConvexField, deform: DeformationMap) -> Float[Tensor, "N 3"]:
    """Unit normals of the cuts across which the gradient F changes most from part to part, over all states together.

    F(X_k) ≈ F̄ + G (X_k − X̄) by least squares; with coordinates u = C^(−1/2) (X − X̄) in which the convex is as long in
    all directions, the greatest change is along the first right singular vector v of G C^(1/2): the cut is u · v = 0.
    """
    with torch.no_grad():
        offsets = field.points - field.centres[:, None]
        gradients = deform(field.points.reshape(-1, 3))[1].reshape(-1, *offsets.shape[:2], 9)
        gradients = gradients.permute(1, 2, 0, 3).flatten(2)  # [N, K, T 9]
        changes = gradients - gradients.mean(dim=1, keepdim=True)
        slopes = torch.linalg.pinv(offsets) @ changes  # [N, 3, T 9]
        values, axes = torch.linalg.eigh(offsets.transpose(1, 2) @ offsets)
        roots = values.clamp(min=1e-8 * values[:, 2:]).sqrt()
        whitened = roots[..., None] * (axes.transpose(1, 2) @ slopes)
        direction = torch.linalg.svd(whitened.transpose(1, 2), full_matrices=False)[2][:, 0]
        normals = (axes @ (direction / roots)[..., None])[..., 0]
        return normals / torch.linalg.vector_norm(normals, dim=1, keepdim=True)


@torch.no_grad()
def halve(points: Float[Tensor, "M K 3"], overlap: Float[Tensor, " M"]) -> Float[Tensor, "M 2 K 3"]:
    """Both parts of each hull, cut across its longest extent, with K points each.

    A triangle is cut through the middle of its longest edge. Of more points, a part keeps those on its side. The others
    are replaced by crossings of the cut with segments between points on either side, each chosen as the farthest from
    those chosen before. All crossings lie in the hull, and so do the parts; the lost volume is small for flat prisms.

    Args:
        overlap: reach of each part beyond the cut [m].
    """
    if points.shape[1] < LEAST_SOLID:
        return _bisected(points, overlap)
    centred = points - points.mean(dim=1, keepdim=True)
    normals = torch.linalg.svd(centred, full_matrices=False)[2][:, 0]
    height = torch.einsum("mki,mi->mk", centred, normals)
    low, high = height.amin(dim=1), height.amax(dim=1)
    middle = 0.5 * (low + high)
    nearest = height.gather(1, (height - middle[:, None]).abs().argmin(dim=1, keepdim=True))[:, 0]
    middle = torch.where((nearest - middle).abs() < CENTRAL_POINT * (high - low), nearest, middle)
    near = overlap + NEAR_CUT * (high - low)  # points this near to the cut belong to both parts
    parts = [_near_part(points, side * (height - middle[:, None]) - near[:, None]) for side in (1, -1)]
    return torch.stack(parts, dim=1)


def _bisected(points: Float[Tensor, "M 3 3"], overlap: Float[Tensor, " M"]) -> Float[Tensor, "M 2 3 3"]:
    """Both parts of triangles."""
    edges = torch.linalg.vector_norm(points.roll(-1, dims=1) - points, dim=2)  # from each point to the next
    rows, first = torch.arange(len(points), device=points.device), edges.argmax(dim=1)
    a, b, opposite = (points[rows, (first + step) % 3] for step in range(3))
    reach = (overlap / edges[rows, first].clamp(min=torch.finfo(points.dtype).tiny)).clamp(max=0.5)[:, None] * (b - a)
    middle = 0.5 * (a + b)
    parts = [torch.stack([opposite, a, middle + reach], dim=1), torch.stack([opposite, middle - reach, b], dim=1)]
    return torch.stack(parts, dim=1)


def _near_part(points: Float[Tensor, "M K 3"], height: Float[Tensor, "M K"]) -> Float[Tensor, "M K 3"]:
    """K points of the parts with height ≤ 0."""
    count = points.shape[1]
    below = height <= 0
    crossing = below[:, :, None] & ~below[:, None]
    rise = height[:, None] - height[:, :, None]
    share = -height[:, :, None] / torch.where(crossing, rise, torch.ones_like(rise))
    between = points[:, :, None] + share[..., None] * (points[:, None] - points[:, :, None])
    candidates = torch.cat([points, between.flatten(1, 2)], dim=1)
    allowed = torch.cat([below, crossing.flatten(1)], dim=1)
    rows = torch.arange(len(points), device=points.device)
    # points on the side go first, in their order; then the farthest crossings; then repetitions of the first
    distance = torch.full_like(allowed, torch.inf, dtype=points.dtype)
    first = torch.arange(allowed.shape[1], device=points.device) < count
    chosen = []
    for _ in range(count):
        rank = torch.where(allowed, torch.where(first, 1e30, distance), -1.0)
        index = rank.argmax(dim=1)
        allowed[rows, index] = False
        chosen.append(candidates[rows, torch.where(rank[rows, index] >= 0, index, below.int().argmax(dim=1))])
        distance = torch.minimum(distance, (candidates - chosen[-1][:, None]).square().sum(dim=-1))
    return torch.stack(chosen, dim=1)
