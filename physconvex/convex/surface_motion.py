"""Surface dynamics: half-spaces that move with a deformation, and conversion from half-spaces to points."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import linprog
from scipy.spatial import HalfspaceIntersection, QhullError
from torch import Tensor

from physconvex.convex.field import numbers
from physconvex.convex.halfspaces import HalfSpaces
from physconvex.convex.hull_points import LEAST_SOLID, fewer_points, padded_points
from physconvex.convex.motion import DeformationMap
from physconvex.errors import InputError


def move_half_spaces(spaces: HalfSpaces, anchors: Float[Tensor, "N 3"], deform: DeformationMap) -> HalfSpaces:
    """The half-spaces under a deformation, each by its first-order expansion at one of its own points.

    A plane n · X = d through A becomes the plane through x(A) with normal F(A)⁻ᵀ n (Nanson). A is the foot of the
    convex's anchor on the plane: the faces of one convex have different gradients if the deformation is not affine.

    Args:
        anchors: a point inside each convex [m], such as its centre.
    """
    missing = spaces.offsets.isinf()
    gap = torch.einsum("nhi,ni->nh", spaces.normals, anchors) - spaces.offsets.masked_fill(missing, 0.0)
    feet = anchors[:, None] - gap.masked_fill(missing, 0.0)[..., None] * spaces.normals
    positions, gradients = deform(feet.reshape(-1, 3))
    normals = torch.linalg.solve(gradients.transpose(1, 2), spaces.normals.reshape(-1, 3, 1))[..., 0]
    length = torch.linalg.vector_norm(normals, dim=1, keepdim=True)
    normals = normals / torch.where(length > 0, length, torch.ones_like(length))
    offsets = (normals * positions).sum(dim=1).reshape(missing.shape)
    return HalfSpaces(normals.reshape(spaces.normals.shape), offsets.masked_fill(missing, torch.inf))


def points_of_half_spaces(spaces: HalfSpaces, *, count: int | None = None) -> Float[Tensor, "N K 3"]:
    """Corners of the intersections of half-spaces [m], padded by repetition to one number K.

    Args:
        count: most points per convex: corners that cost the least volume are omitted. All if not given.

    Raises:
        InputError: an intersection that is empty or not bounded; `count` below four.
    """
    if count is not None and count < LEAST_SOLID:
        raise InputError(f"count: got {count}; expected at least {LEAST_SOLID}")
    arrays, found = (numbers(spaces.normals), numbers(spaces.offsets)), []
    for convex, (normals, offsets) in enumerate(zip(*arrays, strict=True)):
        corners = _corners(normals[np.isfinite(offsets)], offsets[np.isfinite(offsets)], convex)
        found.append(corners if count is None else fewer_points(corners, count))
    most = max([LEAST_SOLID, *map(len, found)]) if count is None else count
    points = np.array([padded_points(some, most) for some in found]).reshape(-1, most, 3)
    return torch.as_tensor(points).to(spaces.normals)


def _corners(normals: np.ndarray, offsets: np.ndarray, convex: int) -> np.ndarray:
    """Corners by duality about the centre of the largest ball inside (which a linear programme finds)."""
    table = np.column_stack([normals, np.ones(len(normals))])
    bounds = [(None, None)] * 3 + [(0, None)]
    found = linprog([0, 0, 0, -1], A_ub=table, b_ub=offsets, bounds=bounds)
    if found.status == 3:
        raise InputError(f"spaces: the half-spaces of convex {convex} leave it without bounds")
    if found.status or found.x[3] <= 0:
        raise InputError(f"spaces: the half-spaces of convex {convex} have no volume in common")
    try:
        both = HalfspaceIntersection(np.column_stack([normals, -offsets]), found.x[:3])
    except QhullError as error:
        raise InputError(f"spaces: convex {convex} has no corners ({str(error).splitlines()[0]})") from None
    corners = both.intersections
    if not np.isfinite(corners).all():
        raise InputError(f"spaces: the half-spaces of convex {convex} leave it without bounds")
    size = np.ptp(corners, axis=0).max()
    _, first = np.unique(np.round(corners / (1e-9 * size)).astype(np.int64), axis=0, return_index=True)
    return np.asarray(corners[np.sort(first)])
