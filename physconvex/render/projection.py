"""From convexes in space to soft-edged polygons on the image plane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from physconvex.convex import ConvexField, view_colours
from physconvex.render.hull import Hulls, planar_hulls
from physconvex.render.view import View

NEAR = 0.01  # near plane [m]
THIN = 0.5  # least width of a drawn convex [pixels]


@dataclass(frozen=True, eq=False)
class Splats:
    """The polygons to draw: M polygons with soft edges, nearest first, with L lines in all.

    Attributes:
        convex: index into the field, shape [M].
        starts: polygon m has the lines starts[m] to starts[m + 1], shape [M + 1].
        lines: (a, b, c) of s = a u + b v + c = α d f, where f is the signed distance from the line on the plane at unit
            distance, positive outside, and d the depth of the convex; shape [L, 3], dimensionless.
        sharpness: β, shape [M].
        opacity: shape [M].
        features: blended values, red, green, blue and the depth d [m], shape [M, 4].
    """

    convex: Int[Tensor, " M"]
    starts: Int[Tensor, " M1"]
    lines: Float[Tensor, "L 3"]
    sharpness: Float[Tensor, " M"]
    opacity: Float[Tensor, " M"]
    features: Float[Tensor, "M 4"]

    def __len__(self) -> int:
        return len(self.convex)

    def differentiable(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Lines, sharpness, opacity, features."""
        return self.lines, self.sharpness, self.opacity, self.features


def project_field(
    field: ConvexField, view: View, *, near: float = NEAR, hulls: Callable[[Tensor], Hulls] = planar_hulls
) -> Splats:
    """The polygons that a view sees of a field, differentiable with respect to both.

    Each polygon is the exact hull of the projected points. The choice of its corners has no gradient; its lines are
    then functions of those corners. Everything nearer than `near` [m] is clipped exactly. A hull less than `THIN`
    pixels wide (a convex seen edge-on, a tiny one) is drawn as a rectangle of that width, see `_rectangles`. Polygons
    are ordered by the mean depth of the points.

    Args:
        hulls: finds the corners: `planar_hulls` or its equivalent in the kernel.
    """
    local = view.local(field.points)
    depths = local[..., 2].clamp(min=near).mean(dim=1)
    directions = field.centres - view.position
    distances = torch.linalg.vector_norm(directions, dim=1, keepdim=True)
    directions = directions / distances.clamp(min=torch.finfo(distances.dtype).tiny)
    features = torch.cat([view_colours(field.harmonics, directions), depths[:, None]], dim=1)

    beyond = local.detach()[..., 2] > near
    whole, cut = beyond.all(dim=1).nonzero()[:, 0], (beyond.any(dim=1) & ~beyond.all(dim=1)).nonzero()[:, 0]
    groups = [
        _polygons(whole, local[whole][..., :2] / local[whole][..., 2:], view, hulls),
        _polygons(cut, _cut(local[cut], beyond[cut], near), view, hulls),
    ]
    owners, lines = (torch.cat(parts) for parts in zip(*groups, strict=True))
    drawn = torch.cat([whole, cut])
    drawn = drawn[torch.sort(depths.detach()[drawn], stable=True).indices]
    rank = torch.empty(len(field), dtype=torch.long, device=drawn.device)
    rank[drawn] = torch.arange(len(drawn), device=drawn.device)
    rank_of_line, by_rank = torch.sort(rank[owners], stable=True)
    owners = owners[by_rank]
    lines = lines[by_rank] * (field.smoothness * depths)[owners, None]
    starts = torch.searchsorted(rank_of_line, torch.arange(len(drawn) + 1, device=drawn.device))
    return Splats(drawn, starts, lines, field.sharpness[drawn], field.opacity[drawn], features[drawn])


def _lines(corners: Float[Tensor, "L 2"], following: Float[Tensor, "L 2"]) -> Float[Tensor, "L 3"]:
    """Unit outward normals and offsets of the lines from corners to following ones, the inside on the left."""
    along = following - corners
    along = along / torch.linalg.vector_norm(along, dim=1, keepdim=True)
    normals = torch.stack([along[:, 1], -along[:, 0]], dim=1)
    return torch.cat([normals, -(normals * corners).sum(dim=1, keepdim=True)], dim=1)


def _cut(local: Float[Tensor, "N K 3"], beyond: Tensor, near: float) -> Float[Tensor, "N C 2"]:
    """Projected points whose hull is that of the parts of convexes beyond the near plane.

    The cut of a hull with a plane is the hull of the cuts of all segments between points on either side. Unused places
    of the list repeat a point.
    """
    count, points = beyond.shape
    first = local[torch.arange(count, device=local.device), beyond.int().argmax(dim=1)][:, None]
    kept = torch.where(beyond[..., None], local, first)
    crossing = beyond[:, :, None] & ~beyond[:, None, :]
    rise = local[:, None, :, 2] - local[:, :, None, 2]
    share = (near - local[:, :, None, 2]) / torch.where(crossing, rise, torch.ones_like(rise))
    between = local[:, :, None] + share[..., None] * (local[:, None] - local[:, :, None])
    between = torch.where(crossing[..., None], between, first[:, None])
    candidates = torch.cat([kept, between.reshape(count, points * points, 3)], dim=1)
    return candidates[..., :2] / candidates[..., 2:]


def _polygons(
    owners: Int[Tensor, " N"], points: Float[Tensor, "N C 2"], view: View, hulls: Callable[[Tensor], Hulls]
) -> tuple[Tensor, Tensor]:
    """Owner [L] and line [L, 3] of every side of the hulls."""
    found = hulls(points)
    least_width = THIN / view.focal.prod().sqrt()
    thin = found.width < least_width.detach()
    corners, following, is_side = _ends(points, found)
    is_side = is_side & ~thin[:, None]
    rectangles = _rectangles(points[thin], 0.5 * least_width)
    owner = torch.cat([owners[:, None].expand(is_side.shape)[is_side], owners[thin].repeat_interleave(4)])
    return owner, torch.cat([_lines(corners[is_side], following[is_side]), rectangles])


def _rectangles(points: Float[Tensor, "N C 2"], margin: Tensor) -> Float[Tensor, "N4 3"]:
    """Lines of the rectangles of all points within a margin of the longest chords, or of squares about tiny hulls.

    Chords shorter than the margin do not determine the rectangle's direction: it would spin with the least motion.
    """
    rows = torch.arange(len(points), device=points.device)
    apart = (points.detach()[:, :, None] - points.detach()[:, None]).square().sum(dim=-1).flatten(1)
    farthest = apart.argmax(dim=1)
    start, end = points[rows, farthest // points.shape[1]], points[rows, farthest % points.shape[1]]
    long = (apart[rows, farthest] > margin.detach() ** 2)[:, None]
    along = torch.where(long, end - start, points.new_tensor([1.0, 0.0]))
    along = along / torch.linalg.vector_norm(along, dim=1, keepdim=True)
    across = torch.stack([along[:, 1], -along[:, 0]], dim=1)
    middle = 0.5 * (start + end)
    start, end = torch.where(long, start, middle), torch.where(long, end, middle)
    normals = torch.stack([across, -across, along, -along], dim=1)
    through = torch.stack([middle, middle, end, start], dim=1)
    offsets = -(normals * through).sum(dim=-1, keepdim=True) - margin
    return torch.cat([normals, offsets], dim=-1).flatten(0, 1)


def _ends(points: Tensor, hulls: Hulls) -> tuple[Tensor, Tensor, Tensor]:
    """Corners in order, the corner after each, and the valid places."""
    place = torch.arange(points.shape[1], device=points.device)
    after = torch.where(place + 1 < hulls.number[:, None], place + 1, 0)
    rows = torch.arange(len(points), device=points.device)[:, None]
    return points[rows, hulls.order], points[rows, hulls.order.gather(1, after)], place < hulls.number[:, None]
