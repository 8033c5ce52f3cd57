"""The silhouette of a surface, filled by the winding number of the border of its front-facing part.

All front-facing triangles have the same orientation in the image. So the winding number of their border about a pixel
is the number of triangles that cover it (two if two parts of the surface overlap). This holds for any surface, also
open or non-manifold ones. The border has a few hundred edges, the surface thousands of triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix

_SHIFT = 4  # fractional binary digits of pixel coordinates of borders


@dataclass(frozen=True, eq=False)
class Borders:
    """Finds the border of a part of a surface.

    Attributes:
        triangles: of the surface, shape [F, 3].
    """

    triangles: Int[np.ndarray, "F 3"]

    @cached_property
    def _edges(self) -> tuple[np.ndarray, csr_matrix]:
        """Every edge once [E, 2], and how the triangles run along it: 1, -1 or 0, shape [E, F]."""
        directed = self.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        edges, index = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
        along = np.where(directed[:, 0] < directed[:, 1], 1, -1)
        owner = np.repeat(np.arange(len(self.triangles)), 3)
        return edges, csr_matrix((along, (index.reshape(-1), owner)), shape=(len(edges), len(self.triangles)))

    def of(self, part: Bool[np.ndarray, " F"]) -> Int[np.ndarray, "B 2"]:
        """Directed border edges of some of the triangles, with multiplicity."""
        edges, runs = self._edges
        count = runs @ part.astype(np.int64)
        border = np.repeat(edges, np.abs(count), axis=0)
        backwards = np.repeat(count < 0, np.abs(count))
        border[backwards] = border[backwards, ::-1]
        return border


def filled_border(
    starts: Float[np.ndarray, "B 2"], ends: Float[np.ndarray, "B 2"], height: int, width: int
) -> Bool[np.ndarray, "H W"]:
    """Pixels whose centre closed polygons wind about, or their edges pass through.

    Args:
        starts, ends: of directed edges, in pixels (the first pixel reaches from 0 to 1).
        height, width: of the image.
    """
    starts, ends = starts - 0.5, ends - 0.5  # centres at whole numbers
    low, high = np.minimum(starts[:, 1], ends[:, 1]), np.maximum(starts[:, 1], ends[:, 1])
    first, last = (np.clip(np.ceil(y), 0, height).astype(int) for y in (low, high))  # rows that are crossed
    edge = np.repeat(np.arange(len(starts)), last - first)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(last - first) - last, last - first)
    run, rise = (ends - starts)[edge].T
    column = np.clip(np.ceil(starts[edge, 0] + (row - starts[edge, 1]) * run / rise), 0, width).astype(int)
    turns = np.bincount(row * (width + 1) + column, np.sign(rise), minlength=height * (width + 1))
    canvas = (np.cumsum(turns.reshape(height, width + 1), axis=1)[:, :width] != 0).astype(np.uint8)
    fixed = np.round(np.stack([starts, ends], axis=1) * 2**_SHIFT).astype(np.int32)
    cv2.polylines(canvas, list(fixed), False, 1, shift=_SHIFT)
    return canvas.view(bool)
