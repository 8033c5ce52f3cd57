"""Convex dynamics: merges neighbours that one hull can replace."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree
from torch import Tensor

from physconvex.convex.field import ConvexField, numbers
from physconvex.convex.hull_points import corners_of, fewer_points, hull_volume, padded_points
from physconvex.convex.motion import DeformationMap
from physconvex.convex.splitting import Division, deviation_from_affine
from physconvex.errors import InputError

NEIGHBOURS = 8  # pairs tried per convex


def merge(
    field: ConvexField,
    *,
    volume_tolerance: float = 0.01,
    colour_tolerance: float = 0.05,
    limit: int | None = None,
    sources: Int[Tensor, " N"] | None = None,
    deform: DeformationMap | None = None,
    distance: float = 0.0,
) -> Division:
    """Merge pairs of neighbours, each convex at most once, into the hull of both.

    A pair may merge if the hull of at most K of its corners differs in volume by at most `volume_tolerance` from the
    two hulls together, and their harmonics by at most `colour_tolerance` (rms over coefficients and channels). Repeat
    to merge further. Pairs of flat convexes do not merge. The merged convex has the mean of colours, α, β and opacity,
    weighted by volume.

    Args:
        volume_tolerance: share of the volume of both that may be added or lost.
        limit: stop at this number of convexes.
        sources: merge only convexes with the same number here, such as parts of one convex (`Division.sources`).
        deform: merge only what stays within `distance` [m] of an affine map in every state of this deformation.
    """
    if volume_tolerance < 0 or colour_tolerance < 0:
        raise InputError(f"tolerances: got {volume_tolerance} and {colour_tolerance}; expected at least 0")
    points = numbers(field.points)
    volumes = np.array([hull_volume(some) for some in points])
    colours = numbers(field.harmonics.flatten(1))
    tried: list[tuple[int, int]] = []
    hulls: list[np.ndarray] = []
    for first, second in _neighbours(points.mean(axis=1), None if sources is None else sources.numpy()).tolist():
        if np.sqrt(np.square(colours[first] - colours[second]).mean()) > colour_tolerance:
            continue
        both = np.concatenate([points[first], points[second]])
        both = both[corners_of(both)]
        hull = fewer_points(both, points.shape[1])
        before = volumes[first] + volumes[second]
        if (
            before == 0
            or abs(hull_volume(hull) - before) > volume_tolerance * before
            or hull_volume(both) > (1 + volume_tolerance) * before
        ):
            continue
        tried.append((first, second))
        hulls.append(padded_points(hull, points.shape[1]))
    free, lost = np.ones(len(field), dtype=bool), 0.0
    taken: list[int] = []
    allowed = _affine(field, tried, hulls, deform, distance)
    for number, (first, second) in enumerate(tried):
        if limit is not None and len(field) - len(taken) <= limit:
            break
        if allowed[number] and free[first] and free[second]:
            free[[first, second]] = False
            taken.append(number)
            lost += max(0.0, volumes[first] + volumes[second] - hull_volume(hulls[number]))
    if not taken:
        return Division(field, torch.arange(len(field)), 0.0)
    left, chosen = torch.as_tensor(np.flatnonzero(free)), torch.as_tensor([tried[k] for k in taken])
    weights = torch.as_tensor(volumes)[chosen] + torch.finfo(torch.float64).tiny
    weights = (weights / weights.sum(dim=1, keepdim=True)).to(field.points)

    def join(tensor: Tensor) -> Tensor:
        mean = (weights.reshape(*weights.shape, *[1] * (tensor.ndim - 1)) * tensor[chosen]).sum(dim=1)
        return torch.cat([tensor[left], mean])

    new = torch.cat([field.points[left], torch.as_tensor(np.array([hulls[k] for k in taken])).to(field.points)])
    return Division(field.map(join).with_points(new), torch.cat([left, chosen[:, 0]]), lost)


def _affine(
    field: ConvexField,
    pairs: list[tuple[int, int]],
    hulls: list[np.ndarray],
    deform: DeformationMap | None,
    distance: float,
) -> Bool[np.ndarray, " P"]:
    """Whether the hulls of pairs stay affine up to a distance [m]; all do without a deformation."""
    if deform is None or not pairs:
        return np.ones(len(pairs), dtype=bool)
    both = field.select(torch.as_tensor(pairs)[:, 0]).with_points(torch.as_tensor(np.array(hulls)).to(field.points))
    return (deviation_from_affine(both, deform)[0].amax(dim=0) <= distance).numpy()


def _neighbours(
    centres: Float[np.ndarray, "N 3"], sources: Int[np.ndarray, " N"] | None = None
) -> Int[np.ndarray, "P 2"]:
    """Pairs of convexes, of the same source if these are given, whose centres are near, nearest first."""
    if sources is not None:  # other sources are far away along a fourth axis
        centres = np.column_stack([centres, 10 * np.ptp(centres, axis=0).max(initial=0.0) * sources])
    count = min(NEIGHBOURS + 1, len(centres))
    distance, other = cKDTree(centres).query(centres, k=[*range(1, count + 1)])
    mine = np.repeat(np.arange(len(centres)), count)
    pairs = np.sort(np.stack([mine, other.ravel()], axis=1), axis=1)
    order = np.argsort(distance.ravel(), kind="stable")
    pairs = pairs[order][pairs[order, 0] < pairs[order, 1]]
    pairs = pairs if sources is None else pairs[sources[pairs[:, 0]] == sources[pairs[:, 1]]]
    _, first = np.unique(pairs, axis=0, return_index=True)
    return pairs[np.sort(first)]
