"""A network on held-out objects: scores, calibration and metrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from models import (
    STATE_SCALE,
    BinConfig,
    Calibration,
    DensityCalibration,
    PhysicsNetwork,
    answer_both_ways,
    fit_density_calibration,
)
from train.data import Item, TrainingClips, collate
from train.losses import skinning_losses

Values = Float[np.ndarray, " N"]


@dataclass(frozen=True, eq=False)
class Answers:
    """What the network says of one quantity of every clip, and its true value."""

    logits: Float[Tensor, "N K"]
    values: Float[Tensor, " N"]
    bins: BinConfig


@dataclass(frozen=True, eq=False)
class Validation:
    """Answers on every clip, and the part that the skinning weights miss (means)."""

    stiffness: Answers
    """Of log10(E/(ρ g L))."""
    poisson: Answers
    states: float
    """Error of the states, in typical magnitudes."""
    span: float
    captured: float

    def score(self) -> float:
        """Score that the best checkpoint minimises: CRPS of both relative to no knowledge, and the missed span."""
        plain = DensityCalibration()
        total = 0.0
        for part in (self.stiffness, self.poisson):
            crps = plain.density(part.logits, part.bins).crps(part.values).mean()
            total += float(crps) / (float(part.values.std(correction=0)) + 1e-6)
        return total + 0.3 * self.span + 0.3 * self.captured

    def calibration(self) -> Calibration:
        """Fitted to these clips."""
        return calibration_of([self])

    def metrics(self, calibration: Calibration) -> tuple[DensityMetrics, DensityMetrics]:
        """Of log10(E/(ρ g L)) and of ν, calibrated."""
        return _metrics(self.stiffness, calibration.stiffness), _metrics(self.poisson, calibration.poisson)


def calibration_of(parts: Sequence[Validation]) -> Calibration:
    """Fitted to the clips of some sets, each of which has the same weight, regardless of its size."""
    counts = [len(part.poisson.values) for part in parts]
    weights = torch.cat([torch.full((count,), 1 / count) for count in counts])

    def fit(answers: Sequence[Answers]) -> DensityCalibration:
        logits, values = (torch.cat([getattr(one, name) for one in answers]) for name in ("logits", "values"))
        return fit_density_calibration(logits, values, answers[0].bins, weights=weights)

    return Calibration(
        stiffness=fit([part.stiffness for part in parts]),
        poisson=fit([part.poisson for part in parts]),
        clips=sum(counts),
    )


def _metrics(part: Answers, fit: DensityCalibration) -> DensityMetrics:
    density = fit.density(part.logits, part.bins)
    columns = (density.quantile(0.5), *fit.interval(density), part.values)
    return density_metrics(*(np.asarray(column, np.float64) for column in columns))


@torch.no_grad()
def validate(network: PhysicsNetwork, clips: TrainingClips, *, batch_size: int = 16) -> Validation:
    """Run the network over all clips, unaugmented, in evaluation mode."""
    network.eval()
    device = next(network.parameters()).device
    columns: list[tuple[Tensor, ...]] = []
    for first in range(0, len(clips), batch_size):
        chosen = range(first, min(first + batch_size, len(clips)))
        batch = collate([clips[Item(0, clip)] for clip in chosen])
        targets = batch.targets.to(device)
        output = answer_both_ways(network, batch.clips.to(device), targets.points)
        assert output.weights is not None
        columns.append(
            (
                output.stiffness_logits.float().cpu(),
                output.poisson_logits.float().cpu(),
                ((output.states.float() - targets.states) / STATE_SCALE.to(device)).abs().mean(dim=(1, 2)).cpu(),
                batch.targets.log10_stiffness,
                batch.targets.poisson_ratio,
                *(part.cpu() for part in skinning_losses(output.weights.float(), targets)),
            )
        )
    stiffness, poisson, states, log10_stiffness, poisson_ratio, span, captured = (
        torch.cat(column) for column in zip(*columns, strict=True)
    )
    return Validation(
        Answers(stiffness, log10_stiffness, network.config.stiffness),
        Answers(poisson, poisson_ratio, network.config.poisson),
        states=float(states.mean()),
        span=float(span.mean()),
        captured=float(captured.mean()),
    )


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
