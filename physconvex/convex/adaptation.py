"""Convex dynamics of a known motion: convexes that bend are split, parts that stay affine together are merged again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.linalg import qr
from torch import Tensor

from physconvex.convex.field import ConvexField
from physconvex.convex.merging import merge
from physconvex.convex.motion import DeformationMap
from physconvex.convex.splitting import deviation_from_affine, split_until_affine
from physconvex.errors import InputError

FRAMES = 8  # most frames of a motion for which a field is split
TOLERANCE = 1e-6  # of the size of a convex: the distance alone counts


@dataclass(frozen=True, eq=False)
class AdaptedField:
    """A field whose convexes move nearly affinely in every state of a motion.

    Attributes:
        field: at rest.
        sources: for each convex the given one that contains it, shape [M].
        given: number of convexes that were given.
        split: their number after splitting, before parts are merged again.
        off_affine: greatest distance of a point of a convex from its place under the convex's best affine map [m], of
            the given field and of this one.
    """

    field: ConvexField
    sources: Int[Tensor, " M"]
    given: int
    split: int
    off_affine: tuple[float, float]

    def __str__(self) -> str:
        before, after = (1e3 * distance for distance in self.off_affine)
        counts = f"{self.given:,} become {self.split:,}, merged to {len(self.field):,}"
        return f"{counts}; at most {after:.2g} mm from affine, {before:.2g} mm before"

    def to_json(self) -> dict[str, int | float]:
        """Numbers of convexes `given`, after `split` and `merged` again; distances from affine before and after [m]."""
        counts = {"given": self.given, "split": self.split, "merged": len(self.field)}
        return {**counts, "off_affine_given_m": self.off_affine[0], "off_affine_m": self.off_affine[1]}


def adapt_to_motion(field: ConvexField, deform: DeformationMap, *, distance: float, limit: int) -> AdaptedField:
    """Split convexes until each of them moves affinely up to a distance, then merge parts that do so together.

    Only parts of the same convex are merged, and only if their hull is nearly their union (`merge`). The union of the
    hulls at rest is unchanged by splitting, which keeps all corners (K may grow), and by merging up to 1 % of a pair. A
    field that moves affinely is returned as it is.

    Args:
        field: at rest.
        deform: of all states for which the field is meant, such as `tet_map` of several frames.
        distance: greatest remaining distance from the best affine map [m], for example a part of a pixel. At element
            faces, and after six halvings, larger ones may remain.
        limit: most convexes; the relatively most bent ones are split first.

    Raises:
        InputError: a distance that is not positive.
    """
    if not distance > 0:
        raise InputError(f"distance: got {distance} m; expected a positive one, such as a part of a pixel")
    count = len(field)
    off = _off_affine(field, deform)
    bent = (off > distance).cpu()
    whole, greatest = torch.arange(count), float(off.max()) if count else 0.0
    if not bent.any() or limit <= count:
        return AdaptedField(field, whole, count, count, (greatest, greatest))
    parted = split_until_affine(
        field.select(bent), deform, tolerance=TOLERANCE, least=distance, limit=limit - int((~bent).sum())
    )
    split = count + len(parted.field) - int(bent.sum())
    parts, sources = _merged(parted.field, parted.sources, deform, distance)
    kept = field.select(~bent)
    added = parts.points.shape[1] - kept.points.shape[1]
    kept = kept.with_points(torch.cat([kept.points, kept.points[:, :1].expand(-1, added, -1)], dim=1))
    left = torch.cat([off[~bent], _off_affine(parts, deform)])
    joined = ConvexField.joined([kept, parts])
    return AdaptedField(
        joined, torch.cat([whole[~bent], whole[bent][sources]]), count, split, (greatest, float(left.max()))
    )


def _merged(
    parts: ConvexField, sources: Int[Tensor, " N"], deform: DeformationMap, distance: float
) -> tuple[ConvexField, Int[Tensor, " M"]]:
    """Parts of the same source, merged as long as that is possible, and their sources."""
    finished = []
    while True:
        merged = merge(parts, sources=sources, deform=deform, distance=distance)
        sources, pairs = sources[merged.sources], len(parts) - len(merged.field)
        again = torch.isin(sources, sources[len(sources) - pairs :])  # merged convexes come last
        finished.append((merged.field.select(~again), sources[~again]))
        if pairs == 0:
            fields, numbers = zip(*finished, strict=True)
            return ConvexField.joined(fields), torch.cat(numbers)
        parts, sources = merged.field.select(again), sources[again]


def _off_affine(field: ConvexField, deform: DeformationMap) -> Float[Tensor, " N"]:
    return deviation_from_affine(field, deform)[0].amax(dim=0)


def bent_frames(
    rest: Float[np.ndarray, "P 3"], positions: Float[np.ndarray, "T P 3"], *, distance: float
) -> Int[np.ndarray, " F"]:
    """The frames, at most eight, for which a field is worth splitting: those that differ most from affine motions.

    Each next one differs most from the affine motions and from the ones chosen before (QR with column pivoting).

    Args:
        rest, positions: points all over the body [m], such as its nodes.
        distance: frames in which all points are as near to their places under the best affine map [m] are left out,
            but for the most bent one.
    """
    affine = np.column_stack([rest, np.ones(len(rest))])
    residual = positions - affine @ (np.linalg.pinv(affine) @ positions)
    farthest = np.linalg.norm(residual, axis=2).max(axis=1)
    bent = np.flatnonzero(farthest > min(distance, 0.999 * farthest.max()))
    if len(bent) == 0:
        return np.array([int(farthest.argmax())])
    _, order = qr(residual[bent].reshape(len(bent), -1).T, mode="r", pivoting=True)
    return np.sort(bent[order[:FRAMES]])
