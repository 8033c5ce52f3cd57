"""Files of a run: its whole state in one safetensors file, configuration, JSON lines, TensorBoard.

All random draws are functions of seed and step (`train.data`, `train.loop`), so that the step number is the state of
every generator and of the sampler.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor, nn
from torch.utils.tensorboard import SummaryWriter

import physconvex
from physconvex import InputError
from physconvex.io import whole_file
from train.config import TrainConfig
from train.records import dataset_checksum

_FORMAT = "physconvex/training_state/1"


@dataclass(frozen=True)
class TrainingProgress:
    """Where a run stands."""

    step: int = 0
    """Updates done."""
    seconds: float = 0.0
    """Spent training, over all its starts [s]."""
    best_score: float | None = None
    """Of the best validation so far; lower is better."""
    fingerprint: str = ""
    """Of configuration and data."""


def read_progress(path: Path) -> TrainingProgress:
    """The state of the run in this file.

    Raises:
        InputError: it is not a training state.
    """
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata() or {}
    if metadata.get("format") != _FORMAT:
        raise InputError(f"out: {path} has format {metadata.get('format')!r}; this version reads {_FORMAT!r}")
    return TrainingProgress(**json.loads(metadata["progress"]))


def refuse_other_run(path: Path, fingerprint: str) -> None:
    """Check that this file, if it exists, belongs to the same run.

    Raises:
        InputError: it belongs to another run, or is not a training state.
    """
    if path.is_file() and read_progress(path).fingerprint != fingerprint:
        raise InputError(
            f"out: {path.parent} holds a run with another configuration or other data; give another folder, or "
            "--no-resume to start anew there"
        )


@dataclass(frozen=True, eq=False)
class TrainingState:
    """Everything that a run goes on from, and its file."""

    path: Path
    network: nn.Module
    average: nn.Module
    optimizer: torch.optim.Optimizer

    def save(self, progress: TrainingProgress) -> None:
        """Write network, moving average and optimiser; a kill at any moment leaves the old file or the new one."""
        tensors = {f"network.{name}": value for name, value in self.network.state_dict().items()}
        tensors |= {f"average.{name}": value for name, value in self.average.state_dict().items()}
        for index, entry in self.optimizer.state_dict()["state"].items():
            for name, value in entry.items():
                tensors[f"optimizer.{index}.{name}"] = torch.as_tensor(value)
        content = save(
            {name: value.detach().cpu().contiguous().clone() for name, value in tensors.items()},
            metadata={"format": _FORMAT, "progress": json.dumps(asdict(progress))},
        )
        with whole_file(self.path) as partial, partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())

    def load(self, fingerprint: str, *, resume: bool) -> TrainingProgress:
        """Restore the file if there is one and it is wanted; a new run's progress otherwise.

        Raises:
            InputError: it belongs to another run, or is not a training state.
        """
        if not (resume and self.path.is_file()):
            return TrainingProgress(fingerprint=fingerprint)
        refuse_other_run(self.path, fingerprint)
        groups: dict[str, dict[str, Tensor]] = {"network": {}, "average": {}, "optimizer": {}}
        with safe_open(self.path, framework="pt") as file:
            for key in file.keys():
                group, name = key.split(".", 1)
                groups[group][name] = file.get_tensor(key)
        self.network.load_state_dict(groups["network"])
        self.average.load_state_dict(groups["average"])
        state: dict[int, dict[str, Tensor]] = {}
        for key, value in groups["optimizer"].items():
            index, name = key.split(".", 1)
            state.setdefault(int(index), {})[name] = value
        self.optimizer.load_state_dict({"state": state, "param_groups": self.optimizer.state_dict()["param_groups"]})
        return read_progress(self.path)


class RunLog:
    """`log.jsonl`, one object a line, and `tensorboard/`; lines beyond `first_step` of a killed run are dropped."""

    def __init__(self, folder: Path, *, first_step: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "log.jsonl"
        kept = [line for line in _whole_lines(path) if json.loads(line)["step"] <= first_step and first_step > 0]
        with whole_file(path) as partial:
            partial.write_text("".join(kept), encoding="utf-8")
        self._file = path.open("a", encoding="utf-8")
        self._board = SummaryWriter(str(folder / "tensorboard"), purge_step=first_step + 1)

    def write(self, kind: str, step: int, **values: object) -> None:
        """One line; numbers also go to TensorBoard."""
        line = {"kind": kind, "step": step, "time": round(time.time(), 3), **values}
        self._file.write(json.dumps(line) + "\n")
        self._file.flush()
        for name, value in _scalars(values):
            self._board.add_scalar(f"{kind}/{name}", value, step)

    def close(self) -> None:
        """End both."""
        self._file.close()
        self._board.close()


def _whole_lines(path: Path) -> list[str]:
    if not path.is_file():
        return []
    return [line for line in path.read_text(encoding="utf-8").splitlines(keepends=True) if line.endswith("}\n")]


def _scalars(values: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, float]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _scalars(value, f"{prefix}{name}/")
        elif isinstance(value, int | float):
            yield prefix + name, float(value)


def run_fingerprint(config: TrainConfig, data: Sequence[Path | str]) -> str:
    """Hash of everything that affects the numbers of a run: configuration (except workers and times) and data."""
    tree = config.model_dump(mode="json", exclude={"workers", "checkpoint_seconds"})
    content = json.dumps([tree, [dataset_checksum(folder) for folder in data]], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


def write_config(folder: Path, config: TrainConfig, data: Sequence[Path | str]) -> None:
    """`config.json`: configuration, data with checksums, version."""
    folder.mkdir(parents=True, exist_ok=True)
    tree = {
        "version": physconvex.__version__,
        "data": {str(path): dataset_checksum(path) for path in data},
        "config": config.model_dump(mode="json"),
    }
    (folder / "config.json").write_text(json.dumps(tree, indent=1) + "\n", encoding="utf-8")
