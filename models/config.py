"""Architecture of the network: frozen, validated, stored as JSON in each checkpoint."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from physconvex.io import FrozenConfig

EncoderSize = Literal["tiny", "small", "base"]

# hidden size, layers, heads; "base" is that of the public VideoMAE weights, "small" that of ViT-S.
_SIZES: dict[str, tuple[int, int, int]] = {"tiny": (192, 6, 3), "small": (384, 12, 6), "base": (768, 12, 12)}


class EncoderConfig(FrozenConfig):
    """VideoMAE encoder (Tong et al. 2022) over tubelets of `tubelet` frames × `patch_size`² pixels."""

    image_size: int = Field(default=80, ge=16)
    """Edge of the windows that follow the object [px] (`models.windows`); the frame network reads them too."""
    frames: int = Field(default=24, ge=2)
    tubelet: int = Field(default=2, ge=1)
    patch_size: int = Field(default=16, ge=4)
    hidden_size: int = Field(default=192, ge=16)
    layers: int = Field(default=6, ge=1)
    heads: int = Field(default=3, ge=1)
    mask_channel: bool = True
    dropout: float = Field(default=0.0, ge=0, lt=1)
    train_keep: float = Field(default=0.6, gt=0, le=1)
    """Share of the tokens that is kept in training; tokens with the object come first, in random order."""
    eval_keep: float = Field(default=1.0, gt=0, le=1)
    """Share of the tokens that is kept in evaluation; tokens without the object are dropped first."""
    position_grid: tuple[int, int, int] | None = None
    """Grid (time, rows, columns) of the pretrained position table; None: a separable table."""

    @classmethod
    def of_size(cls, size: EncoderSize, **options: object) -> EncoderConfig:
        """One of the named sizes; `options` override single fields."""
        hidden, layers, heads = _SIZES[size]
        return cls.model_validate({"hidden_size": hidden, "layers": layers, "heads": heads, **options})

    @model_validator(mode="after")
    def check(self) -> EncoderConfig:
        if self.image_size % self.patch_size or self.frames % self.tubelet or self.hidden_size % self.heads:
            raise ValueError(
                f"image_size {self.image_size}, frames {self.frames}, hidden_size {self.hidden_size} must be "
                f"multiples of patch_size {self.patch_size}, tubelet {self.tubelet}, heads {self.heads}"
            )
        return self

    @property
    def grid(self) -> tuple[int, int, int]:
        """Tokens in time, rows, columns."""
        side = self.image_size // self.patch_size
        return self.frames // self.tubelet, side, side

    @property
    def tokens(self) -> int:
        """Tokens of a whole clip."""
        time, rows, columns = self.grid
        return time * rows * columns

    @property
    def channels(self) -> int:
        """RGB, and the mask."""
        return 4 if self.mask_channel else 3


class KinematicsConfig(FrozenConfig):
    """From the features of each frame to the states of the motion (`models.motion`), and from these to the material."""

    channels: int = Field(default=128, ge=8)
    blocks: int = Field(default=4, ge=1)
    """Blocks from features to states."""
    material_blocks: int = Field(default=4, ge=1)
    """Blocks from states to the embedding."""
    frame_widths: tuple[int, ...] = (48, 64, 64)
    """Channels of the convolutions over single frames; multiples of 8."""
    dropout: float = Field(default=0.1, ge=0, lt=1)
    drop_path: float = Field(default=0.1, ge=0, lt=1)


class BinConfig(FrozenConfig):
    """Equal bins of a density on (low, high); nothing outside can be predicted."""

    low: float
    high: float
    bins: int = Field(ge=2)

    @model_validator(mode="after")
    def check(self) -> BinConfig:
        if not self.low < self.high:
            raise ValueError(f"low {self.low} must be below high {self.high}")
        return self


class SkinningConfig(FrozenConfig):
    """MLP over Fourier features of the rest position whose layers are modulated by the clip."""

    handles: int = Field(default=10, ge=1)
    hidden_size: int = Field(default=64, ge=8)
    layers: int = Field(default=3, ge=1)
    harmonics: int = Field(default=3, ge=1)


class NetworkConfig(FrozenConfig):
    """The whole network."""

    encoder: EncoderConfig = EncoderConfig()
    kinematics: KinematicsConfig = KinematicsConfig()
    stiffness: BinConfig = BinConfig(low=-1.0, high=4.5, bins=110)
    """Bins of log10(E / (ρ g L))."""
    poisson: BinConfig = BinConfig(low=0.0, high=0.5, bins=50)
    skinning: SkinningConfig = SkinningConfig()
    latent_size: int = Field(default=192, ge=8)
    dropout: float = Field(default=0.1, ge=0, lt=1)
    video_dropout: float = Field(default=0.2, ge=0, lt=1)
    """Probability in training of hiding the output of the encoder, so that the other branches are trained too."""
    feature_dropout: float = Field(default=0.3, ge=0, lt=1)
    """Probability in training of estimating the material from the states alone."""
    given_states: float = Field(default=0.3, ge=0, lt=1)
    """Probability in training of estimating it from the true states, with noise."""

    @model_validator(mode="after")
    def check(self) -> NetworkConfig:
        if self.poisson.low < 0 or self.poisson.high > 0.5:
            raise ValueError(f"poisson: ({self.poisson.low}, {self.poisson.high}) must lie within (0, 0.5)")
        return self
