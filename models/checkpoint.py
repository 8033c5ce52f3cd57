"""Checkpoint folders: `model.safetensors` (tensors), `config.json` (everything else), `model_card.md` (summary)."""

from __future__ import annotations

import json
import os
from pathlib import Path

import torch
from pydantic import Field, ValidationError
from safetensors.torch import load_file, save
from torch import Tensor

from models.calibration import Calibration
from models.clip import ClipConfig
from models.config import NetworkConfig
from models.network import PhysicsNetwork
from physconvex import InputError
from physconvex.io import FrozenConfig
from physconvex.numerics import device_named

BUNDLED = Path(__file__).parent / "checkpoints"
_FORMAT = "physconvex/predictor/2"


class ClipSettings(FrozenConfig):
    """`models.clip.ClipConfig` as it is written to JSON."""

    image_size: int = 112
    window: int = 80
    extent: float = 1.7
    frames: int = 24
    target_fps: float = 24.0
    margin: float = 0.1

    def clip_config(self) -> ClipConfig:
        """For `prepare_clip`."""
        return ClipConfig(**self.model_dump())


class TrainingRange(FrozenConfig):
    """Range of the training clips; outside it, predictions carry a warning."""

    log10_stiffness: tuple[float, float] = (-0.2, 3.4)
    """Of log10(E / (ρ g L))."""
    poisson_ratio: tuple[float, float] = (0.2, 0.49)
    interval: tuple[float, float] = (0.1, 0.2)
    """Of Δt √(g/L)."""


class PredictorConfig(FrozenConfig):
    """All of a checkpoint but its tensors."""

    format: str = _FORMAT
    version: str = "0"
    """Of physconvex, when it was written."""
    network: NetworkConfig = NetworkConfig()
    clip: ClipSettings = ClipSettings()
    calibration: Calibration = Calibration()
    training_range: TrainingRange = TrainingRange()
    metrics: dict[str, float] = Field(default_factory=dict)
    """On validation data, after calibration."""

    @classmethod
    def for_network(cls, network: NetworkConfig, **options: object) -> PredictorConfig:
        """With the windows of the encoder."""
        clip = ClipSettings(window=network.encoder.image_size, frames=network.encoder.frames)
        return cls.model_validate({"network": network, "clip": clip, **options})


def find_checkpoint(name_or_path: str | os.PathLike[str]) -> Path:
    """Folder of a bundled checkpoint by its name, or the folder itself.

    Raises:
        InputError: there is none.
    """
    for folder in (Path(name_or_path), BUNDLED / os.fspath(name_or_path)):
        if (folder / "config.json").is_file() and (folder / "model.safetensors").is_file():
            return folder
    names = ", ".join(sorted(p.parent.name for p in BUNDLED.glob("*/config.json"))) or "none"
    raise InputError(
        f"checkpoint: got {os.fspath(name_or_path)!r}; expected a folder with config.json and "
        f"model.safetensors, or the name of a bundled one ({names})"
    )


def save_checkpoint(
    folder: str | os.PathLike[str],
    network: PhysicsNetwork,
    config: PredictorConfig,
    *,
    model_card: str,
    half: bool = True,
) -> None:
    """Write a checkpoint; every file is written atomically. `half` stores float16."""
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    dtype = torch.float16 if half else torch.float32
    tensors = {name: _stored(value, dtype) for name, value in network.state_dict().items()}
    temporary = target / "model.safetensors.part"
    temporary.write_bytes(save(tensors, metadata={"format": "pt"}))
    temporary.replace(target / "model.safetensors")
    text = json.dumps(config.model_dump(mode="json"), indent=1) + "\n"
    for name, content in (("config.json", text), ("model_card.md", model_card)):
        temporary = target / f"{name}.part"
        temporary.write_text(content, encoding="utf-8")
        temporary.replace(target / name)


def _stored(value: Tensor, dtype: torch.dtype) -> Tensor:
    return (value.to(dtype) if value.is_floating_point() else value).detach().cpu().contiguous()


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
    tensors = {name: value.float() for name, value in load_file(folder / "model.safetensors").items()}
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        raise InputError(f"checkpoint: the tensors in {folder} do not fit its config.json: {error}") from error
    return network.to(device_named(device)).eval(), config
