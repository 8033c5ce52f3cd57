"""Closes gaps that a fit leaves inside a body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from physconvex.convex import ConvexField, half_spaces, inside_union
from physconvex.reconstruction.first_convexes import UNPAINTED, WEDGES, lattice_cells, wedges

CELL = 2.0  # footprints
MARGIN = 0.25  # footprints: cells this near to a hull count as covered
LONGEST = 112  # cells along the longest edge of the body at most
BLOCK = 200_000  # cells processed together


def fill_gaps(field: ConvexField, surface: trimesh.Trimesh, *, footprint: float, budget: int) -> ConvexField:
    """The field with additional convexes, up to `budget`, in the parts of a surface's inside that no hull covers.

    They take the place of convexes that are not drawn already (the fillers of another surface).

    The body is divided into cells of two footprints. Cells whose middle is in no hull (nor within a quarter of a
    footprint of one) are joined to boxes, which may extend over other cells of the inside. The largest are cut into
    wedges of six points. They are not drawn (opacity 0.001), so that images do not change, and have the colour of the
    nearest convex.

    Args:
        surface: of the body, outward faces [m].
        footprint: size of a pixel at the object [m].
    """
    drawn = field.select(field.opacity > 2 * UNPAINTED)
    most = budget - len(drawn)
    if field.points.shape[1] < WEDGES.shape[1] or most < 2 or not len(drawn):
        return field
    field = drawn
    low, size = surface.bounds[0], float(np.ptp(surface.bounds, axis=0).max())
    edge = max(CELL * footprint, size / LONGEST)
    shape, middles = lattice_cells(surface, edge)
    inside = np.asarray(surface.contains(middles)).reshape(shape)
    open_cells = _uncovered(field, inside, low, edge, MARGIN * footprint)
    boxes, gains = grown_boxes(open_cells, inside)
    boxes = boxes[np.argsort(-gains, kind="stable")[: most // 2]]
    if not len(boxes):
        return field
    return _joined_to(field, wedges(boxes, low, edge))


def _uncovered(
    field: ConvexField, inside: np.ndarray, low: np.ndarray, edge: float, margin: float
) -> Bool[np.ndarray, "X Y Z"]:
    """Cells of the inside whose middle no hull holds."""
    cells = np.argwhere(inside)
    spaces = half_spaces(field.to(torch.float64))
    blocks = np.array_split(cells, 1 + len(cells) // BLOCK)
    covered = [inside_union(field, low + edge * (some + 0.5), margin=margin, spaces=spaces) for some in blocks]
    found = np.zeros_like(inside)
    found[tuple(cells[~np.concatenate(covered)].T)] = True
    return found


def grown_boxes(
    wanted: Bool[np.ndarray, "X Y Z"], allowed: Bool[np.ndarray, "X Y Z"]
) -> tuple[Int[np.ndarray, "B 2 3"], Int[np.ndarray, " B"]]:
    """Boxes (first cell, cell after the last) of allowed cells that cover all wanted ones, and the new ones in each.

    From each wanted cell outside all boxes, a box grows along x, y, z in turn while the whole next layer is allowed and
    contains a wanted cell.
    """
    left = wanted & allowed
    boxes, gains = [], []
    for cell in np.argwhere(left):
        if not left[tuple(cell)]:
            continue
        ends = np.stack([cell, cell + 1])
        for axis in range(3):
            for side in (1, 0):
                while (layer := _next_layer(ends, axis, side, left.shape)) is not None:
                    if not (allowed[layer].all() and left[layer].any()):
                        break
                    ends[side, axis] += 2 * side - 1
        block = tuple(slice(a, b) for a, b in ends.T)
        gains.append(int(left[block].sum()))
        left[block] = False
        boxes.append(ends)
    return np.array(boxes, dtype=np.int64).reshape(-1, 2, 3), np.array(gains, dtype=np.int64)


def _next_layer(
    ends: Int[np.ndarray, "2 3"], axis: int, side: int, shape: tuple[int, ...]
) -> tuple[slice, slice, slice] | None:
    """The cells that a box would gain, None at the end of the lattice."""
    place = int(ends[1, axis]) if side else int(ends[0, axis]) - 1
    if not 0 <= place < shape[axis]:
        return None
    x, y, z = (slice(place, place + 1) if k == axis else slice(*ends[:, k]) for k in range(3))
    return x, y, z


def _joined_to(field: ConvexField, wedges: Float[np.ndarray, "W 6 3"]) -> ConvexField:
    """The field and undrawn convexes with these points."""
    points = torch.as_tensor(wedges).to(field.points)
    spare = field.points.shape[1] - points.shape[1]
    points = torch.cat([points, points[:, :1].expand(-1, spare, -1)], dim=1)
    near = cKDTree(field.centres.numpy()).query(points.mean(dim=1).numpy())[1]
    new = field.select(torch.as_tensor(near)).with_points(points)
    return ConvexField.joined([field, replace(new, opacity=torch.full_like(new.opacity, UNPAINTED))])
