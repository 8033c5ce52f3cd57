"""Calibration on validation data: temperatures, and split-conformal levels of the 90 % intervals."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from models.config import BinConfig
from models.heads import BinnedDensity
from physconvex import InputError
from physconvex.io import FrozenConfig

COVERAGE = 0.9


class DensityCalibration(FrozenConfig):
    """Calibration of the logits of one head."""

    temperature: float = Field(default=1.0, gt=0)
    """Divisor of the logits."""
    central_level: float = Field(default=COVERAGE, gt=0, le=1)
    """Nominal probability of the central interval that contains 90 % of the validation values."""

    def density(self, logits: Float[Tensor, "B K"], config: BinConfig) -> BinnedDensity:
        """The calibrated density."""
        return BinnedDensity.from_logits(logits, config, temperature=self.temperature)

    def interval(self, density: BinnedDensity) -> tuple[Float[Tensor, " B"], Float[Tensor, " B"]]:
        """Ends of the 90 % interval, in the units of the density."""
        tail = (1 - self.central_level) / 2
        return density.quantile(tail), density.quantile(1 - tail)


class Calibration(FrozenConfig):
    """Calibration of both heads; the default is the uncalibrated network."""

    stiffness: DensityCalibration = DensityCalibration()
    poisson: DensityCalibration = DensityCalibration()
    clips: int = 0
    """Number of validation clips; 0: uncalibrated."""


_TEMPERATURES = torch.logspace(math.log10(0.4), math.log10(4.0), 61).tolist()


def fit_density_calibration(
    logits: Float[Tensor, "N K"],
    values: Float[Tensor, " N"],
    config: BinConfig,
    *,
    weights: Float[Tensor, " N"] | None = None,
) -> DensityCalibration:
    """Temperature with the least CRPS, then the central level by split-conformal prediction.

    The score of a clip is |2 PIT − 1|, the nominal probability of the smallest central interval that contains its value
    (PIT = F(value)). Its ⌈0.9 (N+1)⌉-th smallest is the level (Romano et al. 2019; Chernozhukov et al. 2021,
    "Distributional conformal prediction"). That covers 90 % of exchangeable new clips. With `weights` it is the
    weighted quantile (Tibshirani et al. 2019, eq. 7; a new clip has the largest weight).

    Raises:
        InputError: fewer than nine clips, for which no finite level exists.
    """
    if len(values) < 9:
        raise InputError(
            f"values: got {len(values)} validation clips; expected at least 9 to calibrate a 90 % interval"
        )

    shares = torch.ones_like(values) if weights is None else weights / weights.max()

    def score_of(temperature: float) -> float:
        crps = BinnedDensity.from_logits(logits, config, temperature=temperature).crps(values)
        return float((shares * crps).sum())

    temperature = min(_TEMPERATURES, key=score_of)
    density = BinnedDensity.from_logits(logits, config, temperature=temperature)
    score, order = (2 * density.cdf(values) - 1).abs().sort()
    below = shares[order].double().cumsum(0)
    rank = int((below < COVERAGE * (float(below[-1]) + 1) - 1e-9).sum())
    level = float(score[min(rank, len(score) - 1)])
    return DensityCalibration(temperature=temperature, central_level=min(max(level, 1e-3), 1.0))
