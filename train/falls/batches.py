"""Batches of clips on one device: newly rendered views of falls, and clips of data sets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int, UInt8
from torch import Tensor

from data_gen import CameraConfig
from models import ClipBatch
from train.config import TrainConfig
from train.data import TrainingClips
from train.falls.augment import Shown
from train.falls.prepare import prepare_clips_at_once
from train.falls.views import draw_views
from train.falls.world import Falls, turned


@dataclass(frozen=True, eq=False)
class RealClips:
    """N clips with their labels."""

    windows: UInt8[Tensor, "N T W W 4"]
    moments: Float32[Tensor, "N 2 T M"]
    """Of the mask found, of the true one."""
    valid: Bool[Tensor, "N T"]
    interval: Float32[Tensor, " N"]
    confidence: Float32[Tensor, " N"]
    states: Float32[Tensor, "N T S"]
    log10_stiffness: Float32[Tensor, " N"]
    poisson_ratio: Float32[Tensor, " N"]

    @classmethod
    def of(cls, clips: TrainingClips, device: torch.device | str) -> RealClips:
        """All clips of a split, on a device."""
        prepared = clips.prepared

        def sent(values: np.ndarray) -> Tensor:
            return torch.from_numpy(np.array(values)).to(device)

        return cls(
            windows=sent(prepared.windows),
            moments=sent(prepared.moments),
            valid=sent(prepared.valid),
            interval=sent(clips.interval.astype(np.float32)),
            confidence=sent(prepared.confidence),
            states=sent(np.stack(clips.states)),
            log10_stiffness=sent(clips.log10_stiffness.astype(np.float32)),
            poisson_ratio=sent(clips.poisson_ratio.astype(np.float32)),
        )

    def __len__(self) -> int:
        return len(self.interval)

    def shown(self, chosen: Int[Tensor, " B"], *, true_moments: Bool[Tensor, " B"] | None = None) -> Shown:
        """Some of them as they are."""
        moments = self.moments[chosen]
        which = torch.zeros_like(chosen) if true_moments is None else true_moments.long()
        return Shown(
            windows=self.windows[chosen].float(),
            moments=moments[torch.arange(len(chosen), device=chosen.device), which],
            valid=self.valid[chosen],
            interval=self.interval[chosen],
            states=self.states[chosen],
        )


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
    real: RealClips, chosen: Tensor, weight: float, *, true_moments: Bool[Tensor, " B"] | None = None
) -> FallBatch:
    """Some unchanged clips of data sets, those with the moments of the true masks that are asked for."""
    confidence = real.confidence[chosen]
    labels = (real.log10_stiffness[chosen], real.poisson_ratio[chosen], torch.full_like(confidence, weight))
    return FallBatch(real.shown(chosen, true_moments=true_moments), confidence, *labels)


def joined_batches(one: FallBatch, other: FallBatch) -> FallBatch:
    """Both in one."""
    shown = Shown(*map(_joined, vars(one.shown).values(), vars(other.shown).values()))
    return FallBatch(shown, *map(_joined, list(vars(one).values())[1:], list(vars(other).values())[1:]))


def _joined(one: Tensor, other: Tensor) -> Tensor:
    return torch.cat([one, other])
