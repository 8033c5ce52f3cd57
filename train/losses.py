"""Proper scores of the two densities, and the part of the motion that the skinning weights miss."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from models import (
    STATE_SCALE,
    BinConfig,
    BinnedDensity,
    ClipBatch,
    NetworkConfig,
    NetworkOutput,
    captured_energy_loss,
    differences,
    span_loss,
)
from train.config import LossConfig

_Scores = tuple[Float[Tensor, " B"], Float[Tensor, " B"]]
"""Two numbers of each clip, as the negative logarithmic score and the CRPS of a density."""


@dataclass(frozen=True, eq=False)
class Targets:
    """Targets of a batch."""

    log10_stiffness: Float[Tensor, " B"]
    poisson_ratio: Float[Tensor, " B"]
    states: Float[Tensor, "B T S"]
    """`models.motion.STATE_NAMES`."""
    points: Float[Tensor, "B Q 3"]
    """Object frame, in units of the object size."""
    modes: Float[Tensor, "B Q K"]
    importance: Float[Tensor, "B K"]
    volume_weights: Float[Tensor, "B Q"]
    displacements: Float[Tensor, "B Q N"]
    """Some frames, their components side by side, in units of the object size."""

    def to(self, device: torch.device | str) -> Targets:
        """The same on another device."""
        return Targets(**{name: value.to(device) for name, value in vars(self).items()})


@dataclass(frozen=True, eq=False)
class Losses:
    """Means over the batch; `total` is weighted."""

    stiffness_nll: Float[Tensor, ""]
    stiffness_crps: Float[Tensor, ""]
    poisson_nll: Float[Tensor, ""]
    poisson_crps: Float[Tensor, ""]
    states: Float[Tensor, ""]
    span: Float[Tensor, ""]
    captured: Float[Tensor, ""]
    total: Float[Tensor, ""]


def compute_losses(
    output: NetworkOutput,
    targets: Targets,
    clips: ClipBatch,
    config: LossConfig,
    network: NetworkConfig,
) -> Losses:
    """Cross-entropy with smoothed targets and CRPS for both densities; states; span and captured energy for W."""
    stiffness, poisson = _scores_of_both(output, targets.log10_stiffness, targets.poisson_ratio, config, network)
    assert output.weights is not None
    span, captured = (part.mean() for part in skinning_losses(output.weights.float(), targets))
    densities = _weighted(stiffness, poisson, config, network).mean()
    states = state_loss(output.states.float(), targets.states, clips.interval, clips.valid)
    total = densities + config.states * states
    total = total + config.span * span + config.captured * captured
    return Losses(
        stiffness_nll=stiffness[0].mean(),
        stiffness_crps=stiffness[1].mean(),
        poisson_nll=poisson[0].mean(),
        poisson_crps=poisson[1].mean(),
        states=states,
        span=span,
        captured=captured,
        total=total,
    )


def skinning_losses(weights: Float[Tensor, "B Q M"], targets: Targets) -> _Scores:
    """Missed shares of the eigenmodes and of the motion, of each clip."""
    span = span_loss(weights, targets.modes, targets.volume_weights, targets.importance)
    return span, captured_energy_loss(weights, targets.displacements, targets.points, targets.volume_weights)


def density_losses(
    output: NetworkOutput,
    log10_stiffness: Float[Tensor, " B"],
    poisson_ratio: Float[Tensor, " B"],
    config: LossConfig,
    network: NetworkConfig,
    *,
    weight: Float[Tensor, " B"] | None = None,
) -> Float[Tensor, ""]:
    """Weighted terms of both densities; `weight` is how much each clip counts, once unless given."""
    scores = _scores_of_both(output, log10_stiffness, poisson_ratio, config, network)
    total = _weighted(*scores, config, network)
    return total.mean() if weight is None else (total * weight).mean()


def _scores_of_both(
    output: NetworkOutput,
    log10_stiffness: Float[Tensor, " B"],
    poisson_ratio: Float[Tensor, " B"],
    config: LossConfig,
    network: NetworkConfig,
) -> tuple[_Scores, _Scores]:
    return (
        _scores(output.stiffness_logits, log10_stiffness, network.stiffness, config.smoothing),
        _scores(output.poisson_logits, poisson_ratio, network.poisson, config.smoothing),
    )


def _weighted(stiffness: _Scores, poisson: _Scores, config: LossConfig, network: NetworkConfig) -> Float[Tensor, " B"]:
    """Loss of each clip's scores."""
    one, other = (
        config.nll * nll + config.crps * crps / _scale(bins)
        for (nll, crps), bins in ((stiffness, network.stiffness), (poisson, network.poisson))
    )
    return one + config.poisson * other


def state_loss(
    predicted: Float[Tensor, "B T S"],
    true: Float[Tensor, "B T S"],
    interval: Float[Tensor, " B"],
    valid: Bool[Tensor, "B T"],
) -> Float[Tensor, ""]:
    """Mean absolute error of the states and, by a third, of their rates, in typical magnitudes."""
    error = (predicted - true) / STATE_SCALE.to(predicted.device)
    rates, _ = differences(error, interval, valid)
    weight = valid[..., None] / (valid.sum() * error.shape[-1])
    return ((error.abs() + rates.abs() / 3) * weight).sum()


def _scores(logits: Float[Tensor, "B K"], values: Float[Tensor, " B"], bins: BinConfig, smoothing: float) -> _Scores:
    target = smoothed_target(values, bins, smoothing)
    nll = -(target * logits.float().log_softmax(dim=-1)).sum(dim=-1)
    return nll, BinnedDensity.from_logits(logits, bins).crps(values)


def _scale(bins: BinConfig) -> float:
    """About the CRPS of not knowing: an eighth of the range."""
    return (bins.high - bins.low) / 8


def smoothed_target(values: Float[Tensor, " B"], bins: BinConfig, smoothing: float) -> Float[Tensor, "B K"]:
    """Normal density about each value, cut at the ends, as bin probabilities (Imani & White 2018, HL-Gauss)."""
    edges = torch.linspace(bins.low, bins.high, bins.bins + 1, device=values.device)
    width = (bins.high - bins.low) / bins.bins
    inside = values.clamp(bins.low, bins.high)
    if smoothing == 0:
        place = ((inside - bins.low) / width).long().clamp(max=bins.bins - 1)
        return torch.nn.functional.one_hot(place, bins.bins).float()
    below = torch.special.ndtr((edges - inside[:, None]) / (smoothing * width))
    mass = below.diff(dim=-1)
    return mass / mass.sum(dim=-1, keepdim=True)


def noisy_states(states: Float[Tensor, "B T S"], generator: torch.Generator) -> Float[Tensor, "B T S"]:
    """True states with realistic observation errors: 0.3 to 10 % of typical magnitudes, by clip."""
    device = generator.device
    level = 10 ** (1.5 * torch.rand(states.shape[0], 1, 1, generator=generator, device=device) - 2.5)
    noise = level * torch.randn(states.shape, generator=generator, device=device) * STATE_SCALE.to(device)
    return states + noise.to(states.device)
