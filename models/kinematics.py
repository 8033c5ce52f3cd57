"""Features of the silhouette's path, size and stretch, frame by frame."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from timm.layers import DropPath
from torch import Tensor, nn

from models.silhouette import MOMENT_NAMES

_FLAG = MOMENT_NAMES.index("touches_border")
_FEATURES = 3 * _FLAG + 4


def differences(
    values: Float[Tensor, "B T F"], interval: Float[Tensor, " B"], valid: Bool[Tensor, "B T"]
) -> tuple[Float[Tensor, "B T F"], Float[Tensor, "B T F"]]:
    """First (backward) and second (central) derivatives in dimensionless time; 0 where a frame is missing.

    Args:
        values: one row per frame.
        interval: Δt √(g/L).
        valid: False for repetitions of the last frame.
    """
    step = interval[:, None, None]
    first, second = torch.zeros_like(values), torch.zeros_like(values)
    first[:, 1:] = values.diff(dim=1) / step
    second[:, 1:-1] = first[:, 2:].sub(first[:, 1:-1]) / step
    whole = valid.to(values.dtype)[..., None]
    previous, following = torch.zeros_like(whole), torch.zeros_like(whole)
    previous[:, 1:], following[:, :-1] = whole[:, :-1], whole[:, 1:]
    return first * whole * previous, second * whole * previous * following


def kinematic_features(
    moments: Float[Tensor, "B T M"], interval: Float[Tensor, " B"], valid: Bool[Tensor, "B T"]
) -> Float[Tensor, "B T F"]:
    """Moments, their derivatives, dimensionless time, log2 of the area's change, `touches_border`, valid.

    `moments` are `models.silhouette.MOMENT_NAMES`, lengths in the silhouette's first size.
    """
    shape = moments[..., :_FLAG]
    first, second = differences(shape, interval, valid)
    area = shape[..., MOMENT_NAMES.index("sqrt_area")].clamp(min=1e-3)
    time = torch.arange(moments.shape[1], device=moments.device) * interval[:, None]
    others = torch.stack([time, (area / area[:, :1]).log2(), moments[..., _FLAG], valid.float()], dim=-1)
    return torch.cat([shape, first, second, others], dim=-1)


class SilhouetteFeatures(nn.Module):
    """Moments -> one vector per frame; large features are compressed (asinh) and shown at two scales."""

    feature_scale: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.register_buffer("feature_scale", _default_scale(), persistent=False)
        self.project = nn.Linear(2 * _FEATURES, channels)

    def forward(
        self, moments: Float[Tensor, "B T M"], interval: Float[Tensor, " B"], valid: Bool[Tensor, "B T"]
    ) -> Float[Tensor, "B T C"]:
        """The vectors."""
        scaled = kinematic_features(moments, interval, valid) / self.feature_scale
        return self.project(torch.cat([scaled.asinh(), (8 * scaled).asinh() / 2], dim=-1))


class TemporalBlock(nn.Module):
    """Two dilated convolutions over time with a residual connection, normalised per frame."""

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
        """Frames see their neighbours."""
        inner = self.activation(self.first(self.norm(frames).transpose(1, 2)))
        return frames + self.drop_path(self.second(self.dropout(inner)).transpose(1, 2))


def _default_scale() -> Float[Tensor, " F"]:
    """Typical magnitudes: lengths of one body size, second moments of a tenth, free fall for derivatives."""
    lengths = torch.tensor([0.3, 1.0, 0.5, 0.5, 1.0, 1.0, 0.3, 0.05, 0.03, 0.05])
    return torch.cat([lengths, lengths, 3 * lengths, torch.tensor([1.0, 0.3, 1.0, 1.0])])
