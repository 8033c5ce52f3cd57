"""Quality of densities: errors, coverage and sharpness, compared with the constant predictor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Values = Float[np.ndarray, " N"]


@dataclass(frozen=True)
class DensityMetrics:
    """Of one quantity over N clips."""

    clips: int
    mae: float
    """Mean absolute error of the median."""
    median_error: float
    bias: float
    coverage: float
    """Share of values within the 90 % interval."""
    width: float
    """Mean width of that interval."""
    constant_mae: float
    """Error of the training median, or of this set's own if none is given."""


def density_metrics(
    median: Values, low: Values, high: Values, truth: Values, *, constant: float | None = None
) -> DensityMetrics:
    """Metrics of medians and intervals against the truth."""
    error = median - truth
    return DensityMetrics(
        clips=len(truth),
        mae=float(np.abs(error).mean()),
        median_error=float(np.median(np.abs(error))),
        bias=float(error.mean()),
        coverage=float(((low <= truth) & (truth <= high)).mean()),
        width=float((high - low).mean()),
        constant_mae=constant_mae(truth, constant),
    )


def constant_mae(truth: Values, constant: float | None = None) -> float:
    """Mean absolute error of one number for all: the best one, unless given."""
    return float(np.abs(truth - (np.median(truth) if constant is None else constant)).mean())
