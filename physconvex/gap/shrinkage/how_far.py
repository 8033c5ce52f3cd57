"""How far the gap shrinks on frames that no fit saw, noise floor and placebo subtracted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.location.where import block_bootstrap
from physconvex.gap.options import GapOptions

Positions = Float[np.ndarray, "T P 3"]
__all__ = ["HowFar", "Positions", "gap_squares", "shrinkage_on"]


@dataclass(frozen=True)
class HowFar:
    """Shrinkage of the gap.

    Attributes:
        data: which data it was measured on.
        gap_before, gap_after: rms distance between model and observation [m], noise included.
        noise_floor: what noise and numerical error lead one to expect [m].
        shrinkage: share of the gap above the floor that the effects remove; negative where they make it worse.
        lower, upper: its interval.
        placebo: shrinkage by an effect that screening ranked last, fitted in the same way; NaN where none was.
        placebo_effect: its name.
        net_shrinkage: shrinkage less what the placebo reaches.
    """

    data: str
    gap_before: float
    gap_after: float
    noise_floor: float
    shrinkage: float
    lower: float
    upper: float
    placebo: float
    placebo_effect: str
    net_shrinkage: float

    @property
    def above_error(self) -> float:
        """Share that the effects remove of the gap above noise and numerical error."""
        squares = np.square([self.gap_before, self.gap_after, self.noise_floor])
        return float(_share(*squares))


def gap_squares(base: Baseline, positions: Positions, frames: np.ndarray) -> Float[np.ndarray, " n"]:
    """Mean square distance between model and observation in some frames [m²], shape [n]."""
    rows = base.rows(frames)
    observations = base.observations
    at = observations.frames[rows]
    squares = base.missed(positions)[rows] ** 2
    total = np.bincount(at, squares, minlength=base.model.frames)
    count = np.bincount(at, minlength=base.model.frames)
    return np.asarray(base.components * total[frames] / np.maximum(count[frames], 1))


def _floor(base: Baseline, errors: ErrorModel, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squares that noise alone, and noise with numerical error, lead one to expect [m²]."""
    rows = base.rows(frames)
    observations = base.observations
    at = observations.frames[rows]
    noise = base.lengths[rows] ** 2
    count = np.maximum(np.bincount(at, minlength=base.model.frames), 1)
    both = [
        base.components * np.bincount(at, square, minlength=base.model.frames)[frames] / count[frames]
        for square in (noise, noise * errors.expected[rows])
    ]
    return both[0], both[1]


def _share(before: np.ndarray, after: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """1 − (after − floor)/(before − floor) of mean squares; what lies below the floor counts as at it."""
    open_gap = np.maximum(before - floor, 1e-3 * np.maximum(before, 1e-300))
    return 1.0 - np.maximum(after - floor, 0.0) / open_gap


def shrinkage_on(
    base: Baseline,
    errors: ErrorModel,
    improved: Positions,
    placebo: tuple[str, Positions] | None,
    frames: np.ndarray,
    data: str,
    options: GapOptions,
) -> HowFar:
    """Shrinkage in some frames. Noise is subtracted; the floor that is told includes numerical error.

    Args:
        base: the observations, and what the base model says.
        errors: of the residuals.
        improved: what is observed with the effects [m].
        placebo: name of another effect, and what is observed with it [m].
        frames: in which.
        data: their name.
        options: settings.
    """
    before, after = gap_squares(base, base.positions, frames), gap_squares(base, improved, frames)
    noise, floor = _floor(base, errors, frames)
    draws = block_bootstrap(np.stack([before, after, noise], axis=1), 3, options)
    tail = (1 - options.confidence) / 2
    low, high = np.quantile(_share(draws[:, 0], draws[:, 1], draws[:, 2]), [tail, 1 - tail])
    share = float(_share(before.mean(), after.mean(), noise.mean()))
    other = float("nan")
    if placebo is not None:
        other = float(_share(before.mean(), gap_squares(base, placebo[1], frames).mean(), noise.mean()))
    return HowFar(
        data=data,
        gap_before=float(np.sqrt(before.mean())),
        gap_after=float(np.sqrt(after.mean())),
        noise_floor=float(np.sqrt(floor.mean())),
        shrinkage=share,
        lower=float(low),
        upper=float(high),
        placebo=other,
        placebo_effect="" if placebo is None else placebo[0],
        net_shrinkage=share - (max(other, 0.0) if np.isfinite(other) else 0.0),
    )
