"""The gap by source: noise, numerical error, geometry, observation, dynamics, and the unexplained rest.

Mean squares add up frame by frame. The part that the best effects explain is divided between dynamics, observation and
numerical effects by their Shapley values: the mean contribution of each over all orders of adding the three. No model
runs for that, since effects of the observation and numerical ones act on known motions.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, permutations

import numpy as np
from jaxtyping import Bool, Float

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.search.hypothesis import Hypothesis

Squares = Float[np.ndarray, " T"]
_GROUPS = ("dynamics", "observation", "numerical")


def squares_by_frame(
    base: Baseline, squares: Float[np.ndarray, " N"], rows: Bool[np.ndarray, " N"] | slice = slice(None)
) -> Squares:
    """Mean of the squares [N] in m² over the residuals (or some) of a frame, times the coordinates (a distance)."""
    count, frames = base.model.frames, base.observations.frames[rows]
    seen = np.bincount(frames, minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        total = np.bincount(frames, squares[rows], minlength=count)
        return np.asarray(base.components * total / np.where(seen, seen, np.nan))


def budget_of(base: Baseline, errors: ErrorModel, best: Hypothesis) -> dict[str, Squares]:
    """The gap of the base model by source: mean squares by frame [m²], shape [T] each; NaN if nothing is seen.

    - Noise of the observation.
    - Discretisation: error of mesh, step and contact within the best fit's residual, and the part of numerical effects.
    - Geometry: deviation of the first frame, before any motion, beyond noise: misplaced markers, or a body of another
      shape. It persists in later frames. It is zero for tracked points, which start there.
    - Parts explained by effects of cameras and clocks, and by all other effects; and the rest.
    """
    noise, expected = base.lengths**2, errors.expected * base.lengths**2
    total, left = (squares_by_frame(base, base.missed(x) ** 2) for x in (base.positions, best.positions))
    quiet, floor = squares_by_frame(base, noise), squares_by_frame(base, expected)
    shares = _explained(base, best)
    above = np.clip(left - quiet, 0.0, None)
    geometry = np.minimum(above, np.nan_to_num(above[0]))
    numerical = np.clip(np.minimum(left, floor) - quiet, 0.0, above - geometry)
    return {
        "noise": np.minimum(quiet, total),
        "discretisation": numerical + shares[2],
        "appearance and geometry": geometry,
        "camera and time": shares[1],
        "dynamics explained": shares[0],
        "unexplained": above - geometry - numerical,
    }


def reduction_by_frame(base: Baseline) -> Squares | None:
    """Difference of the reduced model to the full-order one; None if it is not run.

    It is an error of the reduced twin in addition to the gap, which compares the full-order model.
    """
    missed = base.model.directions.get("reduction")
    return None if missed is None else np.asarray((missed[: base.model.frames] ** 2).sum(-1).mean(1))


def _explained(base: Baseline, best: Hypothesis) -> Float[np.ndarray, "3 T"]:
    """Reduction of the squares by dynamics, observation and numerical effects, by frame."""
    subsets = [frozenset(group) for count in range(4) for group in combinations(range(3), count)]
    known = {groups: _left(base, best, groups) for groups in subsets}
    shares = np.zeros((3, base.model.frames))
    orders = list(permutations(range(3)))
    for order in orders:
        for place, group in enumerate(order):
            shares[group] += known[frozenset(order[:place])] - known[frozenset(order[: place + 1])]
    taken = np.clip(shares.sum(0) / len(orders), 0.0, None)  # an effect that makes a frame worse explains nothing of it
    helping = np.clip(shares, 0.0, None)  # of two opposed effects, the harmful one has no share of the joint reduction
    return np.asarray(helping * taken / np.maximum(helping.sum(0), 1e-300))


def _left(base: Baseline, best: Hypothesis, groups: frozenset[int]) -> Squares:
    """Squares by frame with some groups of the best effects alone, the others at their null doses."""
    values = best.values.copy()
    for effect, where in zip(best.model.effects, best.model.slices, strict=True):
        group = _GROUPS.index(effect.source) if effect.source in _GROUPS else 0
        if group not in groups:
            values[where] = effect.null
    motion, correction = (best.motion, best.model.correction) if 0 in groups else (base.motion, base.model.correction)
    positions = replace(best.model, correction=correction).observed(motion, values)
    return squares_by_frame(base, base.missed(positions) ** 2)
