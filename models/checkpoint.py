"""Checkpoint folders: `model.safetensors` (tensors), `config.json` (everything else), `model_card.md` (summary)."""

from __future__ import annotations

import json
import os

from pydantic import Field, ValidationError

from models.calibration import Calibration
from models.checkpoint_files import find_checkpoint, read_tensors
from models.clip import ClipConfig
from models.config import NetworkConfig
from models.network import PhysicsNetwork
from physconvex import InputError
from physconvex.io import FrozenConfig
from physconvex.numerics import device_named

_FORMAT = "physconvex/predictor/2"


class TrainingRange(FrozenConfig):
    """Range of the training clips; outside it, predictions carry a warning."""

    log10_stiffness: tuple[float, float] = (-0.2, 3.4)
    """Range of log10(E / (ρ g L))."""
    poisson_ratio: tuple[float, float] = (0.2, 0.49)
    interval: tuple[float, float] = (0.1, 0.2)
    """Range of Δt √(g/L)."""


class PredictorConfig(FrozenConfig):
    """Content of a checkpoint except its tensors."""

    format: str = _FORMAT
    version: str = "0"
    """Version of physconvex that wrote it."""
    network: NetworkConfig = NetworkConfig()
    clip: ClipConfig = ClipConfig()
    calibration: Calibration = Calibration()
    training_range: TrainingRange = TrainingRange()
    metrics: dict[str, float] = Field(default_factory=dict)
    """Metrics on validation data, after calibration."""

    @classmethod
    def for_network(cls, network: NetworkConfig, **options: object) -> PredictorConfig:
        """With the windows of the encoder."""
        clip = ClipConfig(window=network.encoder.image_size, frames=network.encoder.frames)
        return cls.model_validate({"network": network, "clip": clip, **options})


def load_checkpoint(
    name_or_path: str | os.PathLike[str], *, device: str = "cpu"
) -> tuple[PhysicsNetwork, PredictorConfig]:
    """The network, in float32 and evaluation mode, and its configuration.

    Raises:
        InputError: there is none, it is of another format, or its tensors do not fit its configuration.
    """
    folder = find_checkpoint(name_or_path)
    try:
        tree = json.loads((folder / "config.json").read_text(encoding="utf-8"))
        found = tree.get("format")
        if found != _FORMAT:
            raise InputError(f"checkpoint: {folder} has format {found!r}; this version reads {_FORMAT!r}")
        config = PredictorConfig.model_validate(tree)
    except (ValidationError, json.JSONDecodeError) as error:
        raise InputError(f"checkpoint: {folder / 'config.json'} cannot be read: {error}") from error
    network = PhysicsNetwork(config.network)
    try:
        network.load_state_dict(read_tensors(folder))
    except RuntimeError as error:
        raise InputError(f"checkpoint: the tensors in {folder} do not fit its config.json: {error}") from error
    return network.to(device_named(device)).eval(), config
