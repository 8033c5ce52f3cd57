"""The whole network: video encoder and kinematics branch, one latent, three heads."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, UInt8
from timm.layers import AttentionPoolLatent, Mlp
from torch import Tensor, nn

from models.config import NetworkConfig
from models.encoder import VideoEncoder
from models.heads import DensityHead
from models.kinematics import KinematicsBranch
from models.skinning import SkinningHead

__all__ = ["ClipBatch", "NetworkOutput", "PhysicsNetwork"]

_CONDITIONS = 3


@dataclass(frozen=True, eq=False)
class ClipBatch:
    """What the network reads of B clips of T frames. All numbers are dimensionless."""

    frames: UInt8[Tensor, "B T S S 3"]
    mask: UInt8[Tensor, "B T S S"]
    moments: Float[Tensor, "B T M"]
    valid: Bool[Tensor, "B T"]
    interval: Float[Tensor, " B"]
    """Δt √(g/L)."""
    confidence: Float[Tensor, " B"]
    """Of the foreground, 0..1."""

    def to(self, device: torch.device | str) -> ClipBatch:
        """The same on another device."""
        return ClipBatch(**{name: value.to(device) for name, value in vars(self).items()})


@dataclass(frozen=True, eq=False)
class NetworkOutput:
    """Logits of the two densities (`models.heads`), and what the skinning head reads."""

    stiffness_logits: Float[Tensor, "B K"]
    poisson_logits: Float[Tensor, "B J"]
    latent: Float[Tensor, "B D"]
    weights: Float[Tensor, "B Q M"] | None = None
    """Skinning weights at the points asked for."""


class PhysicsNetwork(nn.Module):
    """VideoMAE tokens and silhouette kinematics -> densities of log10(E/(ρ g L)) and ν; skinning weights."""

    def __init__(self, config: NetworkConfig | None = None, *, encoder: VideoEncoder | None = None) -> None:
        """`encoder` brings pretrained weights (`models.encoder.load_pretrained_encoder`)."""
        super().__init__()
        config = config or NetworkConfig()
        if encoder is not None:
            config = config.model_copy(update={"encoder": encoder.config})
        self.config = config
        hidden = config.encoder.hidden_size
        self.encoder = encoder or VideoEncoder(config.encoder)
        self.kinematics = KinematicsBranch(config.kinematics)
        self.token_norm = nn.LayerNorm(hidden)
        self.token_pool = AttentionPoolLatent(hidden, num_heads=config.encoder.heads, mlp_ratio=1.0)
        self._video_size = 2 * hidden
        joined = self._video_size + self.kinematics.out_features + _CONDITIONS
        self.video_norm = nn.LayerNorm(self._video_size)
        self.motion_norm = nn.LayerNorm(self.kinematics.out_features)
        self.join = Mlp(joined, 2 * config.latent_size, config.latent_size, drop=config.dropout)
        self.latent_norm = nn.LayerNorm(config.latent_size)
        self.stiffness_head = DensityHead(config.latent_size, config.stiffness, dropout=config.dropout)
        self.poisson_head = DensityHead(config.latent_size, config.poisson, dropout=config.dropout)
        self.skinning_head = SkinningHead(config.latent_size, config.skinning)

    def forward(
        self,
        batch: ClipBatch,
        points: Float[Tensor, "B Q 3"] | None = None,
        *,
        video: bool = True,
        generator: torch.Generator | None = None,
    ) -> NetworkOutput:
        """Densities, latent, skinning weights at the points.

        Args:
            batch: the clips.
            points: where to read the skinning weights: object frame, in units of the object size.
            video: False leaves the encoder out; the kinematics branch answers alone.
            generator: CPU generator that draws which tokens and branches training hides.
        """
        motion = self.motion_norm(self.kinematics(batch.moments, batch.interval, batch.valid))
        seen = self._video_embedding(batch, generator) if video else motion.new_zeros(len(motion), self._video_size)
        if self.training:
            hide = torch.rand(len(motion), generator=generator).to(motion.device)[:, None]
            seen = seen * (hide >= self.config.video_dropout)
            motion = motion * (hide <= 1 - self.config.kinematics_dropout) if video else motion
        joined = torch.cat([seen, motion, _conditions(batch)], dim=-1)
        latent = self.latent_norm(self.join(joined))
        return NetworkOutput(
            stiffness_logits=self.stiffness_head(latent),
            poisson_logits=self.poisson_head(latent),
            latent=latent,
            weights=None if points is None else self.skinning_head(latent, points),
        )

    def _video_embedding(self, batch: ClipBatch, generator: torch.Generator | None) -> Float[Tensor, "B E"]:
        """Mean of the tokens, weighted by how much of the object they show, and attention pooling."""
        tokens, coverage = self.encoder(batch.frames, batch.mask, generator=generator)
        tokens = self.token_norm(tokens)
        weight = coverage + 1e-4
        mean = (tokens * weight[..., None]).sum(dim=1) / weight.sum(dim=1, keepdim=True)
        return self.video_norm(torch.cat([mean, self.token_pool(tokens)], dim=-1))


def _conditions(batch: ClipBatch) -> Float[Tensor, "B C"]:
    """log2 of the frame interval and of the time shown, both about zero for training data, and confidence."""
    shown = batch.interval * batch.valid.sum(dim=1)
    return torch.stack([batch.interval.log2() + 3, shown.log2() - 1.5, batch.confidence - 0.5], dim=-1)
