"""From convexes in space to soft-edged polygons on the image plane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
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


@dataclass(frozen=True, eq=False)
class Outline:
    """Which points are the corners of polygons that belong to a group of convexes: no gradients.

    Attributes:
        owners: indices of the convexes, shape [N].
        rows, corners, following: convex of the group, place of a corner and of the one after it, for each side, [S].
        thin: indices of the group's convexes that are drawn as rectangles, shape [R].
    """

    owners: Int[Tensor, " N"]
    rows: Int[Tensor, " S"]
    corners: Int[Tensor, " S"]
    following: Int[Tensor, " S"]
    thin: Int[Tensor, " R"]

    @classmethod
    def of(
        cls, owners: Int[Tensor, " N"], points: Float[Tensor, "N C 2"], hulls: Callable[[Tensor], Hulls], least: Tensor
    ) -> Outline:
        """Of candidates in the plane at unit distance; hulls narrower than `least` are thin."""
        found = hulls(points)
        thin = found.width < least
        place = torch.arange(points.shape[1], device=points.device)
        after = torch.where(place + 1 < found.number[:, None], place + 1, 0)
        rows, sides = ((place < found.number[:, None]) & ~thin[:, None]).nonzero(as_tuple=True)
        following = found.order.gather(1, after)
        return cls(owners, rows, found.order[rows, sides], following[rows, sides], thin.nonzero()[:, 0])

    @property
    def owner_of_line(self) -> Int[Tensor, " L"]:
        """Convex of each line."""
        return torch.cat([self.owners[self.rows], self.owners[self.thin].repeat_interleave(4)])

    def lines(self, points: Float[Tensor, "N C 2"], margin: Tensor) -> Float[Tensor, "L 3"]:
        """Lines of the sides, and of the rectangles."""
        sides = _lines(points[self.rows, self.corners], points[self.rows, self.following])
        return torch.cat([sides, _rectangles(points[self.thin], margin)])


@dataclass(frozen=True, eq=False)
class PolygonPlan:
    """Everything about the polygons that has no gradient: what is drawn, in which order, with which corners.

    Attributes:
        whole, cut: convexes beyond the near plane, and those that it cuts.
        beyond: which points of the latter lie beyond it.
        near: distance of that plane [m].
        convex: the convexes that are drawn, nearest first, shape [M].
        by_rank: order of the lines of both groups, shape [L].
        starts: first line of each polygon, and the end, shape [M + 1].
    """

    whole: Outline
    cut: Outline
    beyond: Bool[Tensor, "N K"]
    near: float
    convex: Int[Tensor, " M"]
    by_rank: Int[Tensor, " L"]
    starts: Int[Tensor, " M1"]

    @classmethod
    @torch.no_grad()
    def of(cls, field: ConvexField, view: View, *, near: float, hulls: Callable[[Tensor], Hulls]) -> PolygonPlan:
        """For a field and a view."""
        local = view.local(field.points)
        depths = local[..., 2].clamp(min=near).mean(dim=1)
        beyond = local[..., 2] > near
        whole, cut = beyond.all(dim=1).nonzero()[:, 0], (beyond.any(dim=1) & ~beyond.all(dim=1)).nonzero()[:, 0]
        least = _least_width(view)
        groups = (
            Outline.of(whole, local[whole][..., :2] / local[whole][..., 2:], hulls, least),
            Outline.of(cut, _cut(local[cut], beyond[cut], near), hulls, least),
        )
        drawn = torch.cat([whole, cut])
        drawn = drawn[torch.sort(depths[drawn], stable=True).indices]
        rank = torch.empty(len(field), dtype=torch.long, device=drawn.device)
        rank[drawn] = torch.arange(len(drawn), device=drawn.device)
        rank_of_line, by_rank = torch.sort(rank[torch.cat([group.owner_of_line for group in groups])], stable=True)
        starts = torch.searchsorted(rank_of_line, torch.arange(len(drawn) + 1, device=drawn.device))
        return cls(*groups, beyond[cut], near, drawn, by_rank, starts)

    def splats(self, field: ConvexField, view: View) -> Splats:
        """The polygons, differentiable with respect to the field and the view."""
        local = view.local(field.points)
        depths = local[..., 2].clamp(min=self.near).mean(dim=1)
        directions = field.centres - view.position
        distances = torch.linalg.vector_norm(directions, dim=1, keepdim=True)
        directions = directions / distances.clamp(min=torch.finfo(distances.dtype).tiny)
        features = torch.cat([view_colours(field.harmonics, directions), depths[:, None]], dim=1)
        whole, margin = local[self.whole.owners], 0.5 * _least_width(view)
        lines = torch.cat(
            [
                self.whole.lines(whole[..., :2] / whole[..., 2:], margin),
                self.cut.lines(_cut(local[self.cut.owners], self.beyond, self.near), margin),
            ]
        )[self.by_rank]
        owners = torch.cat([self.whole.owner_of_line, self.cut.owner_of_line])[self.by_rank]
        lines = lines * (field.smoothness * depths)[owners, None]
        chosen = self.convex
        return Splats(chosen, self.starts, lines, field.sharpness[chosen], field.opacity[chosen], features[chosen])


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
    return PolygonPlan.of(field, view, near=near, hulls=hulls).splats(field, view)


def _least_width(view: View) -> Tensor:
    """Of a drawn polygon, on the plane at unit distance."""
    return THIN / view.focal.prod().sqrt()


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
