"""The kinematics branch: what the silhouette's path, size and stretch say, frame by frame."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from timm.layers import AttentionPoolLatent, DropPath
from torch import Tensor, nn

from models.config import KinematicsConfig
from models.silhouette import MOMENT_NAMES

__all__ = ["KinematicsBranch", "kinematic_features"]

_FLAG = MOMENT_NAMES.index("touches_border")
_FEATURES = 3 * _FLAG + 4


def kinematic_features(
    moments: Float[Tensor, "B T M"], interval: Float[Tensor, " B"], valid: Bool[Tensor, "B T"]
) -> Float[Tensor, "B T F"]:
    """Moments, their first and second derivatives, dimensionless time, and the two flags.

    Args:
        moments: `models.silhouette.MOMENT_NAMES`, lengths in the silhouette's first size.
        interval: Δt √(g/L).
        valid: frames that are no repetition of the last one.

    Central second difference, backward first difference, both in the time unit √(L/g) and zero where a frame
    they need is missing. The last flags: `touches_border`, valid; before them log2 of the area's change.
    """
    shape = moments[..., :_FLAG]
    step = interval[:, None, None]
    first = torch.zeros_like(shape)
    first[:, 1:] = shape.diff(dim=1) / step
    second = torch.zeros_like(shape)
    second[:, 1:-1] = first[:, 2:].sub(first[:, 1:-1]) / step
    whole = valid.float()
    previous, following = _shifted(whole, 1), _shifted(whole, -1)
    first, second = first * (whole * previous)[..., None], second * (whole * previous * following)[..., None]
    area = shape[..., MOMENT_NAMES.index("sqrt_area")].clamp(min=1e-3)
    growth = (area / area[:, :1]).log2()
    time = torch.arange(moments.shape[1], device=moments.device) * interval[:, None]
    others = torch.stack([time, growth, moments[..., _FLAG], whole], dim=-1)
    return torch.cat([shape, first, second, others], dim=-1)


def _shifted(flags: Float[Tensor, "B T"], by: int) -> Float[Tensor, "B T"]:
    moved = torch.zeros_like(flags)
    if by > 0:
        moved[:, by:] = flags[:, :-by]
    else:
        moved[:, :by] = flags[:, -by:]
    return moved


class _Block(nn.Module):
    """Two dilated convolutions with a residual connection, normalised per frame."""

    def __init__(self, channels: int, dilation: int, dropout: float, drop_path: float) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(channels)
        self.first = nn.Conv1d(channels, channels, 3, padding=dilation, dilation=dilation)
        self.second = nn.Conv1d(channels, channels, 3, padding=1)
        self.activation, self.dropout, self.drop_path = nn.GELU(), nn.Dropout(dropout), DropPath(drop_path)
        with torch.no_grad():
            for parameter in self.second.parameters():
                parameter.zero_()

    def forward(self, frames: Float[Tensor, "B T C"]) -> Float[Tensor, "B T C"]:
        inner = self.activation(self.first(self.norm(frames).transpose(1, 2)))
        return frames + self.drop_path(self.second(self.dropout(inner)).transpose(1, 2))


class KinematicsBranch(nn.Module):
    """Moments [B, T, M] -> embedding [B, 3 C]: mean, maximum and attention over the valid frames."""

    feature_scale: Tensor

    def __init__(self, config: KinematicsConfig) -> None:
        super().__init__()
        self.register_buffer("feature_scale", _default_scale())
        self.project = nn.Linear(2 * _FEATURES, config.channels)
        self.blocks = nn.ModuleList(
            _Block(config.channels, 2 ** (k % 3), config.dropout, config.drop_path) for k in range(config.blocks)
        )
        self.norm = nn.LayerNorm(config.channels)
        self.pool = AttentionPoolLatent(config.channels, num_heads=4, mlp_ratio=1.0)
        self.out_features = 3 * config.channels

    def forward(
        self, moments: Float[Tensor, "B T M"], interval: Float[Tensor, " B"], valid: Bool[Tensor, "B T"]
    ) -> Float[Tensor, "B D"]:
        """The embedding; large features are compressed (asinh) and shown at two scales."""
        scaled = kinematic_features(moments, interval, valid) / self.feature_scale
        frames = self.project(torch.cat([scaled.asinh(), (8 * scaled).asinh() / 2], dim=-1))
        for block in self.blocks:
            frames = block(frames)
        frames = self.norm(frames) * valid[..., None]
        count = valid.sum(dim=1, keepdim=True).clamp(min=1)
        highest = frames.masked_fill(~valid[..., None], -1e4).amax(dim=1)
        return torch.cat([frames.sum(dim=1) / count, highest, self.pool(frames)], dim=-1)


def _default_scale() -> Float[Tensor, " F"]:
    """Typical magnitudes: lengths of one body size, second moments of a tenth, free fall for derivatives."""
    lengths = torch.tensor([0.3, 1.0, 0.5, 0.5, 1.0, 1.0, 0.3, 0.05, 0.03, 0.05])
    return torch.cat([lengths, lengths, 3 * lengths, torch.tensor([1.0, 0.3, 1.0, 1.0])])
