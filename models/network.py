"""The whole network: features of each frame, motion of the body, one latent, three heads."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, UInt8
from timm.layers import AttentionPoolLatent, Mlp
from torch import Tensor, nn

from models.config import NetworkConfig
from models.encoder import VideoEncoder, normalised
from models.heads import DensityHead
from models.kinematics import SilhouetteFeatures
from models.motion import MotionBranch
from models.skinning import SkinningHead

_CONDITIONS = 3
_CONVOLUTIONS = ((8, 4, 2), (3, 2, 1), (3, 1, 1))  # kernel, stride, padding; the last one for all that follow


@dataclass(frozen=True, eq=False)
class ClipBatch:
    """Input of the network: B clips of T frames. All numbers are dimensionless."""

    windows: UInt8[Tensor, "B T W W 4"]
    """RGB and coverage about the object (`models.windows`)."""
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
    """Logits of the two densities (`models.heads`), states, and the input of the skinning head."""

    stiffness_logits: Float[Tensor, "B K"]
    poisson_logits: Float[Tensor, "B J"]
    states: Float[Tensor, "B T S"]
    """`models.motion.STATE_NAMES`."""
    latent: Float[Tensor, "B D"]
    weights: Float[Tensor, "B Q M"] | None = None
    """Skinning weights at the given points."""


class FrameNetwork(nn.Module):
    """Windows that follow the object -> one vector per frame, from that frame and the first one.

    Convolutions of stride 4, 2, then 1; the last map is read whole, not averaged, since the position of the outline
    matters.
    """

    def __init__(self, channels: int, *, widths: tuple[int, ...], window: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        inputs, side = 4, window
        for number, width in enumerate(widths):
            size, stride, padding = _CONVOLUTIONS[min(number, len(_CONVOLUTIONS) - 1)]
            layers += [nn.Conv2d(inputs, width, size, stride, padding), nn.GroupNorm(8, width), nn.GELU()]
            inputs, side = width, (side + 2 * padding - size) // stride + 1
        self.layers = nn.Sequential(*layers)
        self.reduce = nn.Conv2d(inputs, 32, 1)
        self.read = nn.Linear(32 * side * side, channels)
        self.compare = nn.Linear(channels, channels)

    def forward(self, pictures: Float[Tensor, "B T 4 W W"]) -> Float[Tensor, "B T C"]:
        """The vectors, of pictures as `models.encoder.normalised` gives them."""
        maps = nn.functional.gelu(self.reduce(self.layers(pictures.flatten(0, 1))))
        vectors = self.read(maps.flatten(1)).unflatten(0, pictures.shape[:2])
        return vectors + self.compare(vectors[:, :1])


class PhysicsNetwork(nn.Module):
    """Windows, silhouettes -> states of the motion -> densities of log10(E/(ρ g L)) and ν; skinning weights."""

    def __init__(self, config: NetworkConfig | None = None, *, encoder: VideoEncoder | None = None) -> None:
        """`encoder` brings pretrained weights (`models.encoder.load_pretrained_encoder`)."""
        super().__init__()
        config = config or NetworkConfig()
        if encoder is not None:
            config = config.model_copy(update={"encoder": encoder.config})
        self.config = config
        hidden, channels, latent = config.encoder.hidden_size, config.kinematics.channels, config.latent_size
        self.silhouettes = SilhouetteFeatures(channels)
        frame = config.kinematics
        self.frame_network = FrameNetwork(channels, widths=frame.frame_widths, window=config.encoder.image_size)
        self.encoder = encoder or VideoEncoder(config.encoder)
        self.token_norm = nn.LayerNorm(hidden)
        self.token_pool = AttentionPoolLatent(hidden, num_heads=config.encoder.heads, mlp_ratio=1.0)
        self.token_features = nn.Linear(hidden, config.encoder.tubelet * channels)
        self.motion = MotionBranch(config.kinematics)
        self.video_norm, self.motion_norm = nn.LayerNorm(2 * hidden), nn.LayerNorm(self.motion.out_features)
        joined = 2 * hidden + self.motion.out_features + _CONDITIONS
        self.join = Mlp(joined, 2 * latent, latent, drop=config.dropout)
        self.latent_norm = nn.LayerNorm(latent)
        self.stiffness_head = DensityHead(latent, config.stiffness, dropout=config.dropout)
        self.poisson_head = DensityHead(latent, config.poisson, dropout=config.dropout)
        self.skinning_head = SkinningHead(latent, config.skinning)

    def forward(
        self,
        batch: ClipBatch,
        points: Float[Tensor, "B Q 3"] | None = None,
        *,
        states: Float[Tensor, "B T S"] | None = None,
        generator: torch.Generator | None = None,
    ) -> NetworkOutput:
        """Densities, states, latent, skinning weights at the points.

        Args:
            batch: the clips.
            points: where the skinning weights are evaluated: object frame, in units of the object size.
            states: true states (training), which replace the predicted ones in some clips.
            generator: CPU generator of the random choices in training.
        """
        draws = torch.rand(3, len(batch.interval), generator=generator).to(batch.interval.device)
        with torch.autocast(batch.moments.device.type, enabled=False):
            features = self.silhouettes(batch.moments, batch.interval, batch.valid)
        pictures = normalised(batch.windows)
        by_frame, embedding = self._tokens(pictures, generator)
        if self.training:
            shown = draws[0] >= self.config.video_dropout
            by_frame, embedding = by_frame * shown[:, None, None], embedding * shown[:, None]
        features = features + self.frame_network(pictures) + by_frame
        with torch.autocast(features.device.type, enabled=False):  # rates are differences of states: full precision
            motion = self.motion(
                features.float(),
                batch.interval,
                batch.valid,
                given=states,
                use_given=draws[1] < self.config.given_states if self.training else None,
                hide_features=draws[2] < self.config.feature_dropout if self.training else None,
            )
            joined = torch.cat([embedding.float(), self.motion_norm(motion.embedding), _conditions(batch)], dim=-1)
            latent = self.latent_norm(self.join(joined))
            return NetworkOutput(
                stiffness_logits=self.stiffness_head(latent),
                poisson_logits=self.poisson_head(latent),
                states=motion.states,
                latent=latent,
                weights=None if points is None else self.skinning_head(latent, points),
            )

    def _tokens(
        self, pictures: Float[Tensor, "B T 4 W W"], generator: torch.Generator | None
    ) -> tuple[Float[Tensor, "B T C"], Float[Tensor, "B E"]]:
        """Features of each frame, and of the whole clip, from the encoder's tokens."""
        tokens, coverage, place = self.encoder(pictures, generator=generator)
        tokens, weight = self.token_norm(tokens), (coverage + 1e-4)[..., None]
        mean = (tokens * weight).sum(dim=1) / weight.sum(dim=1)
        embedding = self.video_norm(torch.cat([mean, self.token_pool(tokens)], dim=-1))
        time, rows, columns = self.config.encoder.grid
        moment = nn.functional.one_hot(place // (rows * columns), time).to(tokens.dtype) * weight
        by_time = moment.transpose(1, 2) @ tokens / (moment.sum(dim=1)[..., None] + 1e-4)
        by_frame = self.token_features(by_time).unflatten(2, (self.config.encoder.tubelet, -1)).flatten(1, 2)
        return by_frame, embedding


def _conditions(batch: ClipBatch) -> Float[Tensor, "B C"]:
    """log2 of the frame interval and of the time shown, both about zero for training data, and confidence."""
    shown = batch.interval * batch.valid.sum(dim=1)
    return torch.stack([batch.interval.log2() + 3, shown.log2() - 1.5, batch.confidence - 0.5], dim=-1)
