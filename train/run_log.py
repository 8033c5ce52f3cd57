"""Records of a run besides its tensors: configuration, JSON lines, TensorBoard."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

import physconvex
from train.config import TrainConfig
from train.records import dataset_checksum


class RunLog:
    """`log.jsonl`, one object a line, and `tensorboard/`; lines beyond `first_step` of a killed run are dropped."""

    def __init__(self, folder: Path, *, first_step: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "log.jsonl"
        kept = [line for line in _whole_lines(path) if json.loads(line)["step"] <= first_step and first_step > 0]
        part = path.with_suffix(".part")
        part.write_text("".join(kept), encoding="utf-8")
        part.replace(path)
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
