"""Files of a network's checkpoint: tensors, configuration in JSON, model card; the finder's networks read from them."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import torch
from pydantic import Field, ValidationError
from safetensors.torch import load_file, save
from torch import Tensor, nn

from physconvex import InputError
from physconvex.io import FrozenConfig, whole_file

BUNDLED: Path = Path(__file__).parent / "checkpoints"

_Config = TypeVar("_Config", bound="FinderConfig")
_Network = TypeVar("_Network", bound=nn.Module)


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


class FinderConfig(FrozenConfig):
    """Common part of the configurations of the finder's two networks."""

    version: str = "0"
    """Version of physconvex that wrote it."""
    metrics: dict[str, float] = Field(default_factory=dict)
    """Metrics on validation data."""


def load_finder_network(
    folder: str | os.PathLike[str], config: type[_Config], build: Callable[[_Config], _Network], *, name: str
) -> _Network:
    """A network in float32 and evaluation mode, channels last.

    Raises:
        InputError: there is none, it is of another format, or its tensors do not fit its configuration.
    """
    root = Path(folder)
    try:
        network = build(config.model_validate(json.loads((root / "config.json").read_text(encoding="utf-8"))))
        network.load_state_dict(read_tensors(root))
    except (OSError, ValidationError, json.JSONDecodeError, RuntimeError) as error:
        raise InputError(
            f"{name}: {root} cannot be read ({error}); expected a folder made by `physconvex train-{name}`"
        ) from error
    return network.to(memory_format=torch.channels_last).eval()


def read_tensors(folder: Path) -> dict[str, Tensor]:
    """The tensors of a checkpoint, in float32."""
    return {name: value.float() for name, value in load_file(folder / "model.safetensors").items()}


def save_network(
    folder: str | os.PathLike[str], network: nn.Module, config: FrozenConfig, *, model_card: str, half: bool = True
) -> None:
    """Write `model.safetensors`, `config.json` and `model_card.md`, each atomically. `half` stores float16."""
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    dtype = torch.float16 if half else torch.float32
    tensors = {name: _stored(value, dtype) for name, value in network.state_dict().items()}
    contents = {
        "model.safetensors": save(tensors, metadata={"format": "pt"}),
        "config.json": (json.dumps(config.model_dump(mode="json"), indent=1) + "\n").encode(),
        "model_card.md": model_card.encode(),
    }
    for name, content in contents.items():
        with whole_file(target / name) as partial:
            partial.write_bytes(content)


def _stored(value: Tensor, dtype: torch.dtype) -> Tensor:
    return (value.to(dtype) if value.is_floating_point() else value).detach().cpu().contiguous()
