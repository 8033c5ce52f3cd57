"""Prepared clips of data sets as tensors on one device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int, UInt8
from torch import Tensor

from train.data import TrainingClips
from train.falls.augment import Shown


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
