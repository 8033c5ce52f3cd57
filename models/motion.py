"""From the features of each frame to the body's motion and deformation, and from these to the material.

The state of each frame (`STATE_NAMES`) is known exactly in simulations and determines stiffness: position and mean
deformation gradient. Its supervision makes good use of few clips. The heads read it together with its input features.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from timm.layers import AttentionPoolLatent
from torch import Tensor, nn

from models.config import KinematicsConfig
from models.kinematics import TemporalBlock, differences

STATE_NAMES = (
    # of the centre of mass since the first frame, over the object size: right, away from the camera, up
    *("shift_x", "shift_y", "shift_z"),
    # lowest point over the floor, and height of the body, over the object size
    *("lowest", "height"),
    # of the mean deformation gradient F: logarithms of the principal stretches, descending; of its determinant
    *("log_stretch_1", "log_stretch_2", "log_stretch_3", "log_volume"),
    # root mean square of the displacement that is not affine, over the object size
    "bending",
    # F − 1 in the object frame, row by row, against the first frame's orientation
    *(f"gradient_{i}{j}" for i in "xyz" for j in "xyz"),
)

STATE_SCALE = torch.tensor([0.2, 0.2, 0.3, 0.3, 0.2, 0.1, 0.05, 0.1, 0.1, 0.03, *[0.6] * 9])
"""Typical magnitudes."""

_STATES = len(STATE_NAMES)


@dataclass(frozen=True, eq=False)
class MotionOutput:
    """Predicted states, and the embedding of features and motion."""

    states: Float[Tensor, "B T S"]
    embedding: Float[Tensor, "B E"]


class MotionBranch(nn.Module):
    """Features of each frame -> states -> embedding of the motion."""

    state_scale: Tensor

    def __init__(self, config: KinematicsConfig) -> None:
        super().__init__()
        channels = config.channels
        self.register_buffer("state_scale", STATE_SCALE.clone(), persistent=False)
        self.seeing = _blocks(config, config.blocks)
        self.state_norm, self.state_head = nn.LayerNorm(channels), nn.Linear(channels, _STATES)
        self.project = nn.Linear(6 * _STATES + 2, channels)
        self.features = nn.Linear(channels, channels)
        self.understanding = _blocks(config, config.material_blocks)
        self.norm = nn.LayerNorm(channels)
        self.pool = AttentionPoolLatent(channels, num_heads=4, mlp_ratio=1.0)
        self.out_features = 3 * channels

    def forward(
        self,
        features: Float[Tensor, "B T C"],
        interval: Float[Tensor, " B"],
        valid: Bool[Tensor, "B T"],
        *,
        given: Float[Tensor, "B T S"] | None = None,
        use_given: Bool[Tensor, " B"] | None = None,
        hide_features: Bool[Tensor, " B"] | None = None,
    ) -> MotionOutput:
        """States and embedding.

        Args:
            features: one row per frame.
            interval: Δt √(g/L).
            valid: False for repetitions of the last frame.
            given: true states, which replace the predicted ones in the clips `use_given` (training).
            use_given: clips.
            hide_features: clips in which the second half reads only the states (training).
        """
        shown = valid[..., None]
        seen = self.state_norm(self.seeing(features * shown))
        states = self.state_head(seen) * self.state_scale
        read = states
        if given is not None and use_given is not None:
            read = torch.where(use_given[:, None, None], given.to(states.dtype), states)
        beside = self.features(seen)
        if hide_features is not None:
            beside = beside * ~hide_features[:, None, None]
        frames = self.understanding(self.project(self._state_features(read * shown, interval, valid)) + beside)
        frames = self.norm(frames) * shown
        count = valid.sum(dim=1, keepdim=True).clamp(min=1)
        highest = frames.masked_fill(~shown, -1e4).amax(dim=1)
        return MotionOutput(states, torch.cat([frames.sum(dim=1) / count, highest, self.pool(frames)], dim=-1))

    def _state_features(
        self, states: Float[Tensor, "B T S"], interval: Float[Tensor, " B"], valid: Bool[Tensor, "B T"]
    ) -> Float[Tensor, "B T F"]:
        """States and their derivatives at two scales, time, and whether the frame is one."""
        scaled = states / self.state_scale
        first, second = differences(scaled, interval, valid)
        features = torch.cat([scaled, first / 3, second / 10], dim=-1)
        time = torch.arange(states.shape[1], device=states.device) * interval[:, None]
        others = torch.stack([time, valid.float()], dim=-1)
        return torch.cat([features.asinh(), (8 * features).asinh() / 2, others], dim=-1)


def _blocks(config: KinematicsConfig, count: int) -> nn.Sequential:
    return nn.Sequential(
        *(TemporalBlock(config.channels, 2 ** (k % 3), config.dropout, config.drop_path) for k in range(count))
    )
