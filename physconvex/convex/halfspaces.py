"""Convexes as intersections of half-spaces, and their occupancy in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError
from torch import Tensor

from physconvex.convex.field import ConvexField, numbers
from physconvex.convex.hull_points import LEAST_SOLID, outward_faces
from physconvex.errors import InputError

COPLANAR = 1e-9  # faces closer than this, in units of the convex's size, count once
FLAT = 1e-6  # ratio of least to greatest extent below which a convex has no reliable volume
THICKENED = 1e-4  # displacement of the points of flat convexes, relative to their size


@dataclass(frozen=True, eq=False)
class HalfSpaces:
    """The half-spaces n · x ≤ d whose intersections the convexes are, padded to the same number H.

    Attributes:
        normals: outward unit normals, shape [N, H, 3]; zero where there is none.
        offsets: distances d of the planes from the origin, shape [N, H], metres; infinite where there is none.
    """

    normals: Float[Tensor, "N H 3"]
    offsets: Float[Tensor, "N H"]

    def distances(self, positions: Float[Tensor, "Q 3"]) -> Float[Tensor, "Q N H"]:
        """Signed distances n · x − d [m] of positions [m], negative inside; −∞ where there is no half-space."""
        return torch.einsum("qi,nhi->qnh", positions, self.normals) - self.offsets


def hull_faces(points: Float[np.ndarray, "K 3"]) -> Int[np.ndarray, "H 3"]:
    """One triangle of points for each plane of a hull, anticlockwise seen from outside.

    Raises:
        InputError: points without volume.
    """
    centred = np.asarray(points, dtype=np.float64) - points.mean(axis=0)
    centred /= max(float(np.abs(centred).max()), np.finfo(float).tiny)
    try:
        hull = ConvexHull(centred)
    except QhullError:
        raise InputError("points: all in one plane; their hull has no volume") from None
    same = np.abs(hull.equations[:, None] - hull.equations).max(axis=2) <= COPLANAR
    keep = np.flatnonzero(same.argmax(axis=1) == np.arange(len(same)))  # the first of each plane
    return outward_faces(hull)[keep]


def _with_volume(points: Float[Tensor, "N K 3"]) -> Float[Tensor, "N L 3"]:
    """The points; those of flat convexes are moved apart by a fixed ten-thousandth of their size.

    Triangles become prisms.
    """
    if points.shape[1] < LEAST_SOLID:
        a, b, c = points.unbind(dim=1)
        cross = torch.linalg.cross(b - a, c - a)
        longest = torch.stack([b - a, c - a, c - b]).norm(dim=-1).amax(dim=0)
        length = cross.norm(dim=-1).clamp(min=torch.finfo(points.dtype).tiny)
        away = (THICKENED * longest / length)[:, None, None] * cross[:, None]
        points = torch.cat([points + away, points - away], dim=1)
    centred = points.detach() - points.detach().mean(dim=1, keepdim=True)
    extents = torch.linalg.svdvals(centred)
    flat = extents[:, 2] <= FLAT * extents[:, 0]
    generator = torch.Generator().manual_seed(0)
    shift = 2 * torch.rand(points.shape[1:], generator=generator, dtype=torch.float64) - 1
    size = centred.abs().amax(dim=(1, 2)).clamp(min=torch.finfo(torch.float32).eps)
    return points + THICKENED * (flat * size)[:, None, None] * shift.to(points)


def half_spaces(field: ConvexField) -> HalfSpaces:
    """The half-spaces of all convexes, differentiable with respect to the points.

    The choice of the points of a plane has no gradient; the plane is then a function of its three points. Flat convexes
    count with a thickness of about a ten-thousandth of their size.
    """
    points = _with_volume(field.points)
    faces = [hull_faces(some) for some in numbers(points)]
    most = max(map(len, faces), default=0)
    corners = np.zeros((len(field), most, 3), dtype=np.int64)
    for row, some in zip(corners, faces, strict=True):
        row[: len(some)] = some
    missing = torch.as_tensor(np.arange(most) >= np.array([len(some) for some in faces])[:, None])
    rows = torch.arange(len(field))[:, None, None]
    a, b, c = points[rows, torch.as_tensor(corners)].unbind(dim=2)
    cross = torch.linalg.cross(b - a, c - a)
    missing = missing.to(cross.device)
    safe = torch.where(missing[..., None], torch.ones_like(cross), cross)
    normals = safe / torch.linalg.vector_norm(safe, dim=-1, keepdim=True)
    offsets = (normals * a).sum(dim=-1)
    return HalfSpaces(normals.masked_fill(missing[..., None], 0.0), offsets.masked_fill(missing, torch.inf))


def occupancy(
    field: ConvexField, positions: Float[Tensor, "Q 3"], *, spaces: HalfSpaces | None = None
) -> Float[Tensor, "Q N"]:
    """Occupancy sigmoid(−β log Σ_h exp(α f_h)) of each convex at positions [m], f_h from `HalfSpaces.distances` [m].

    Args:
        spaces: the field's half-spaces if they are already known, or other ones.
    """
    spaces = half_spaces(field) if spaces is None else spaces
    scaled = field.smoothness[:, None] * spaces.distances(positions)
    return torch.sigmoid(-field.sharpness * torch.logsumexp(scaled, dim=-1))
