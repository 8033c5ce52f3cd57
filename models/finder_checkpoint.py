"""Checkpoints of the finder's two networks: tensors in float16, a configuration in JSON, a model card."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from pydantic import Field, ValidationError
from safetensors.torch import load_file, save
from torch import nn

from physconvex import InputError
from physconvex.io import FrozenConfig

_Config = TypeVar("_Config", bound="FinderConfig")
_Network = TypeVar("_Network", bound=nn.Module)


class FinderConfig(FrozenConfig):
    """Common part of both networks' configurations."""

    version: str = "0"
    """Of physconvex, when it was written."""
    metrics: dict[str, float] = Field(default_factory=dict)
    """On validation data."""


def load_finder_network(
    folder: str | os.PathLike[str], config: type[_Config], build: Callable[[_Config], _Network], *, name: str
) -> tuple[_Config, _Network]:
    """A network in float32 and evaluation mode.

    Raises:
        InputError: there is none, it is of another format, or its tensors do not fit its configuration.
    """
    root = Path(folder)
    try:
        settings = config.model_validate(json.loads((root / "config.json").read_text(encoding="utf-8")))
        network = build(settings)
        network.load_state_dict({k: v.float() for k, v in load_file(root / "model.safetensors").items()})
    except (OSError, ValidationError, json.JSONDecodeError, RuntimeError) as error:
        raise InputError(
            f"{name}: {root} cannot be read ({error}); expected a folder made by `physconvex train-{name}`"
        ) from error
    return settings, network.eval()


def save_finder_network(
    folder: str | os.PathLike[str], network: nn.Module, config: FinderConfig, *, model_card: str
) -> None:
    """Write `model.safetensors` (float16), `config.json` and `model_card.md`, each atomically."""
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    tensors = {k: v.detach().half().cpu().contiguous() for k, v in network.state_dict().items()}
    contents = {
        "model.safetensors": save(tensors, metadata={"format": "pt"}),
        "config.json": (json.dumps(config.model_dump(mode="json"), indent=1) + "\n").encode(),
        "model_card.md": model_card.encode(),
    }
    for name, content in contents.items():
        part = target / f"{name}.part"
        part.write_bytes(content)
        part.replace(target / name)
