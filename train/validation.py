"""A network on held-out objects: scores, calibration and metrics."""

from __future__ import annotations

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
    captured_energy_loss,
    fit_density_calibration,
    span_loss,
)
from train.data import Item, TrainingClips, collate
from train.metrics import DensityMetrics, density_metrics


@dataclass(frozen=True, eq=False)
class Validation:
    """Logits and truth of every clip, and the part that the skinning weights miss (means)."""

    stiffness_logits: Float[Tensor, "N K"]
    poisson_logits: Float[Tensor, "N J"]
    log10_stiffness: Float[Tensor, " N"]
    poisson_ratio: Float[Tensor, " N"]
    states: float
    """Error of the states, in typical magnitudes."""
    span: float
    captured: float
    stiffness_bins: BinConfig
    poisson_bins: BinConfig

    def score(self) -> float:
        """Score that the best checkpoint minimises: CRPS of both relative to no knowledge, and the missed span."""
        plain = DensityCalibration()
        total = 0.0
        for logits, values, bins in self._parts():
            crps = plain.density(logits, bins).crps(values).mean()
            total += float(crps) / (float(values.std(correction=0)) + 1e-6)
        return total + 0.3 * self.span + 0.3 * self.captured

    def calibration(self) -> Calibration:
        """Fitted to these clips."""
        fits = [fit_density_calibration(*part) for part in self._parts()]
        return Calibration(stiffness=fits[0], poisson=fits[1], clips=len(self.poisson_ratio))

    def metrics(self, calibration: Calibration) -> tuple[DensityMetrics, DensityMetrics]:
        """Of log10(E/(ρ g L)) and of ν, calibrated."""
        results = []
        for part, fit in zip(self._parts(), (calibration.stiffness, calibration.poisson), strict=True):
            logits, values, bins = part
            density = fit.density(logits, bins)
            columns = (density.quantile(0.5), *fit.interval(density), values)
            results.append(density_metrics(*(np.asarray(column, np.float64) for column in columns)))
        return results[0], results[1]

    def _parts(self) -> list[tuple[Tensor, Tensor, BinConfig]]:
        return [
            (self.stiffness_logits, self.log10_stiffness, self.stiffness_bins),
            (self.poisson_logits, self.poisson_ratio, self.poisson_bins),
        ]


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
        weights = output.weights.float()
        columns.append(
            (
                output.stiffness_logits.float().cpu(),
                output.poisson_logits.float().cpu(),
                ((output.states.float() - targets.states) / STATE_SCALE.to(device)).abs().mean(dim=(1, 2)).cpu(),
                batch.targets.log10_stiffness,
                batch.targets.poisson_ratio,
                span_loss(weights, targets.modes, targets.volume_weights, targets.importance).cpu(),
                captured_energy_loss(weights, targets.displacements, targets.points, targets.volume_weights).cpu(),
            )
        )
    stiffness, poisson, states, log10_stiffness, poisson_ratio, span, captured = (
        torch.cat(column) for column in zip(*columns, strict=True)
    )
    return Validation(
        stiffness_logits=stiffness,
        poisson_logits=poisson,
        log10_stiffness=log10_stiffness,
        poisson_ratio=poisson_ratio,
        states=float(states.mean()),
        span=float(span.mean()),
        captured=float(captured.mean()),
        stiffness_bins=network.config.stiffness,
        poisson_bins=network.config.poisson,
    )
