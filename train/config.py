"""Configuration of a training run: frozen, readable from YAML, stored with the run."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from models import ClipConfig, NetworkConfig
from physconvex.io import FrozenConfig, read_tree, validated


class AugmentConfig(FrozenConfig):
    """Augmentations that do not change E/(ρ g L) and ν. Shares are probabilities per clip."""

    flip_share: float = Field(default=0.5, ge=0, le=1)
    latest_start: int = Field(default=3, ge=0)
    """Largest number of first frames that are dropped."""
    stride_share: float = Field(default=0.15, ge=0, le=1)
    """Probability of taking every other frame, at twice the interval."""
    shorten_share: float = Field(default=0.2, ge=0, le=1)
    """Probability of dropping last frames; at least two thirds remain."""
    zoom: float = Field(default=0.05, ge=0, lt=0.5)
    shift: float = Field(default=0.03, ge=0, lt=0.5)
    """Largest shift of the windows, relative to their edge."""
    colour: float = Field(default=0.3, ge=0, lt=1)
    """Largest relative change of brightness, contrast and saturation."""
    grey_share: float = Field(default=0.1, ge=0, le=1)
    mask_share: float = Field(default=0.2, ge=0, le=1)
    """Probability of dilating or eroding the masks by a pixel."""
    moment_noise: float = Field(default=0.002, ge=0)
    """Standard deviation of the noise on the moments, in body sizes."""
    true_moments_share: float = Field(default=0.3, ge=0, le=1)
    """Probability of using the moments of the true mask instead of the found mask."""


class LossConfig(FrozenConfig):
    """Weights of the terms of the loss."""

    nll: float = Field(default=1.0, ge=0)
    crps: float = Field(default=1.0, ge=0)
    """Weight of the CRPS relative to that of the constant predictor."""
    poisson: float = Field(default=1.0, ge=0)
    """Weight of all terms of ν relative to those of the stiffness."""
    states: float = Field(default=2.0, ge=0)
    """Weight of the states of the motion in each frame."""
    span: float = Field(default=0.3, ge=0)
    captured: float = Field(default=0.3, ge=0)
    smoothing: float = Field(default=1.0, ge=0)
    """Standard deviation of the target, in bins."""
    modes: int = Field(default=10, ge=1)
    """Eigenmodes of the span term."""


class TrainConfig(FrozenConfig):
    """Settings of one training run."""

    network: NetworkConfig = NetworkConfig()
    pretrained: str | None = None
    """Public VideoMAE weights, by folder or name; None trains from scratch."""
    checkpoint: str | None = None
    """Checkpoint of this network to start from, by folder or name; its training clips should not be held out here."""
    margin: float = Field(default=0.1, ge=0)
    """Margin of the square around the path of the object (`models.clip.ClipConfig`)."""
    extent: float = Field(default=1.7, gt=0)
    """Extent of the windows that follow the object, in sizes of the object."""
    seed: int = Field(default=0, ge=0)
    epochs: int = Field(default=30, ge=1)
    batch_size: int = Field(default=32, ge=1)
    """Clips per step, over all processes."""
    optimizer: str = "adamw"
    learning_rate: float = Field(default=1e-3, gt=0)
    weight_decay: float = Field(default=0.05, ge=0)
    warmup_share: float = Field(default=0.05, ge=0, lt=1)
    final_share: float = Field(default=0.01, ge=0, le=1)
    """Final learning rate relative to the first."""
    gradient_clip: float = Field(default=1.0, gt=0)
    ema_decay: float = Field(default=0.998, ge=0, lt=1)
    mixed_precision: Literal["no", "bf16"] = "no"
    true_mask_share: float = Field(default=0.2, ge=0, le=1)
    """Share of training clips with the true mask instead of the found one."""
    checkpoint_seconds: float = Field(default=120.0, ge=0)
    validate_every: int = Field(default=1, ge=1)
    """Epochs between validations."""
    workers: int = Field(default=1, ge=0)
    """Processes that augment clips; 0: the training process does it."""
    augment: AugmentConfig = AugmentConfig()
    loss: LossConfig = LossConfig()

    @model_validator(mode="after")
    def check(self) -> TrainConfig:
        if self.pretrained is not None and self.checkpoint is not None:
            raise ValueError("pretrained and checkpoint both say where to start; give one of them")
        return self

    @property
    def clip(self) -> ClipConfig:
        """How clips are prepared."""
        encoder = self.network.encoder
        return ClipConfig(window=encoder.image_size, extent=self.extent, frames=encoder.frames, margin=self.margin)


def load_train_config(source: str | Path | None = None, **overrides: object) -> TrainConfig:
    """Configuration from a preset name (`default`), a YAML file, or the defaults; `overrides` of None are ignored.

    Raises:
        InputError: no such file or preset, bad YAML, an unknown name or a value out of range.
    """
    tree = {} if source is None else read_tree(source, "train", argument="config", expected="names and values")
    tree |= {name: value for name, value in overrides.items() if value is not None}
    return validated(TrainConfig, tree, argument="config")
