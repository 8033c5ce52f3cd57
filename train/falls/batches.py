"""Batches of clips on one device: newly rendered views of falls, and clips of data sets."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from data_gen import CameraConfig
from models import ClipBatch
from train.config import TrainConfig
from train.falls.augment import Shown
from train.falls.prepare import prepare_clips_at_once
from train.falls.real import RealClips
from train.falls.views import draw_views
from train.falls.world import Falls, turned


@dataclass(frozen=True, eq=False)
class FallBatch:
    """Clips, labels, and how much each label counts."""

    shown: Shown
    confidence: Tensor
    log10_stiffness: Tensor
    poisson_ratio: Tensor
    weight: Tensor

    def clips(self) -> ClipBatch:
        """As the network reads them."""
        shown = self.shown
        windows = shown.windows.round().clamp(0, 255).byte()
        return ClipBatch(windows, shown.moments, shown.valid, shown.interval, self.confidence)


def draw_batch(
    falls: Falls,
    chosen: Tensor,
    confidence: Tensor,
    *,
    config: TrainConfig,
    camera: CameraConfig,
    generator: torch.Generator,
) -> FallBatch:
    """Random views of some falls, prepared as at inference."""
    views = draw_views(falls, chosen, camera, generator)
    windows, moments = prepare_clips_at_once(views.images, views.masks, config.clip)
    shown = Shown(
        windows,
        moments,
        valid=torch.ones(moments.shape[:2], dtype=torch.bool, device=chosen.device),
        interval=falls.interval[chosen],
        states=turned(falls.states[chosen], views.turn),
    )
    return FallBatch(
        shown, confidence, falls.log10_stiffness[chosen], falls.poisson_ratio[chosen], torch.ones_like(confidence)
    )


def real_batch(
    real: RealClips, chosen: Tensor, config: TrainConfig, weight: float, generator: torch.Generator
) -> FallBatch:
    """Some unchanged clips of data sets, occasionally with the moments of the true masks."""
    draw = torch.rand(len(chosen), generator=generator, device=chosen.device)
    shown = real.shown(chosen, true_moments=draw < config.augment.true_moments_share)
    weights = torch.full_like(draw, weight)
    return FallBatch(shown, real.confidence[chosen], real.log10_stiffness[chosen], real.poisson_ratio[chosen], weights)


def joined_batches(one: FallBatch, other: FallBatch) -> FallBatch:
    """Both in one."""
    shown = Shown(*map(_joined, vars(one.shown).values(), vars(other.shown).values()))
    return FallBatch(shown, *map(_joined, list(vars(one).values())[1:], list(vars(other).values())[1:]))


def _joined(one: Tensor, other: Tensor) -> Tensor:
    return torch.cat([one, other])
