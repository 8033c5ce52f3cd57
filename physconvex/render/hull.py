"""Convex hulls of many small sets of points in a plane."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Hulls:
    """Corners among the points, without gradients.

    Attributes:
        order: indices of the corners in order of rising angle (u towards v), zero beyond their number, shape [N, C].
        number: how many corners, shape [N].
        width: the least, over sides, of the greatest distance of a point from that side, zero for less than three
            corners, shape [N], in the unit of the points.
    """

    order: Int[Tensor, "N C"]
    number: Int[Tensor, " N"]
    width: Float[Tensor, " N"]


def planar_hulls(points: Float[Tensor, "N C 2"]) -> Hulls:
    """The hulls of N sets of C points.

    Gift wrapping (Jarvis 1973) in float64: from the point of least v (then least u), the next corner is the point that
    leaves all others on its left; of several in line, the farthest. Points in line and repeated points are not
    corners: the hull of points in line has two corners, that of equal points one.
    """
    points = points.detach().double()
    order, number = _wrapped(points)
    return Hulls(order, number, _widths(points, order, number))


def _wrapped(points: Float[Tensor, "N C 2"]) -> tuple[Int[Tensor, "N C"], Int[Tensor, " N"]]:
    """Corners in order, and their number."""
    count, candidates = points.shape[:2]
    rows = torch.arange(count, device=points.device)
    least_v = points[..., 1].amin(dim=1, keepdim=True)
    start = points[..., 0].masked_fill(points[..., 1] > least_v, torch.inf).argmin(dim=1)
    order = torch.zeros((count, candidates), dtype=torch.long, device=points.device)
    number = torch.zeros(count, dtype=torch.long, device=points.device)
    current, open_ = start, torch.ones(count, dtype=torch.bool, device=points.device)
    for step in range(candidates):
        order[:, step] = torch.where(open_, current, 0)
        number += open_
        current = _next_corner(points - points[rows, current][:, None])
        # back at the start, or at a repetition of it
        open_ = open_ & (points[rows, current] != points[rows, start]).any(dim=1)
        if not open_.any():
            break
    return order, number


def _next_corner(offsets: Float[Tensor, "N C 2"]) -> Int[Tensor, " N"]:
    """The point with all others on the left of the ray from the origin to it, the farthest of those in line."""
    best, index = offsets[:, 0], torch.zeros(len(offsets), dtype=torch.long, device=offsets.device)
    for candidate in range(1, offsets.shape[1]):
        other = offsets[:, candidate]
        cross = best[:, 0] * other[:, 1] - best[:, 1] * other[:, 0]
        farther = other.square().sum(dim=1) > best.square().sum(dim=1)
        better = (cross < 0) | ((cross == 0) & farther)
        best = torch.where(better[:, None], other, best)
        index = torch.where(better, candidate, index)
    return index


def _widths(points: Float[Tensor, "N C 2"], order: Tensor, number: Tensor) -> Float[Tensor, " N"]:
    """Least widths."""
    rows = torch.arange(len(points), device=points.device)
    widths = torch.full_like(points[:, 0, 0], torch.inf)
    for step in range(order.shape[1]):
        corner = points[rows, order[:, step]]
        following = points[rows, order.gather(1, ((step + 1) % number.clamp(min=1))[:, None])[:, 0]]
        along = following - corner
        offsets = points - corner[:, None]
        reach = (along[:, None, 0] * offsets[..., 1] - along[:, None, 1] * offsets[..., 0]).amax(dim=1)
        reach = reach / torch.linalg.vector_norm(along, dim=1)
        widths = torch.where(step < number, torch.minimum(widths, reach), widths)
    return torch.where(number > 2, widths, 0.0)
