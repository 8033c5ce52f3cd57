"""Record of the command, version and configuration of each run, stored with the results."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import torch
from pydantic import JsonValue

import physconvex
from inference.preparation import Predictor


def start_run(out: Path, *, command: Sequence[str] | None, configuration: Mapping[str, JsonValue]) -> int:
    """Add a run to `run.json` and return its number (a resumed batch has several runs)."""
    runs = _read_runs(out)
    runs.append(
        {
            "command": shlex.join(sys.argv if command is None else command),
            "started": _now(),
            "finished": None,
            "physconvex": physconvex.__version__,
            "python": platform.python_version(),
            "torch": torch.__version__,
            "platform": platform.platform(),
            "configuration": dict(configuration),
        }
    )
    _write_runs(out, runs)
    return len(runs) - 1


def finish_run(out: Path, number: int, **counts: int) -> None:
    """Record the end of a run and its counts; a killed run keeps `finished: null`."""
    runs = _read_runs(out)
    runs[number] |= {"finished": _now(), **counts}
    _write_runs(out, runs)


def checkpoint_digest(predictor: Predictor) -> str:
    """Return a digest of a predictor's weights and configuration: results of another checkpoint are never reused."""
    digest = hashlib.sha256(repr(predictor.config).encode())
    for key, tensor in sorted(predictor.network.state_dict().items()):
        digest.update(key.encode())
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()[:16]


def _read_runs(out: Path) -> list[dict[str, JsonValue]]:
    try:
        runs = json.loads((out / "run.json").read_text(encoding="utf-8"))["runs"]
    except (FileNotFoundError, ValueError, KeyError):
        return []
    return list(runs)


def _write_runs(out: Path, runs: list[dict[str, JsonValue]]) -> None:
    temporary = out / ".partial-run.json"
    text = json.dumps({"schema": "physconvex/runs/1", "runs": runs}, indent=1, ensure_ascii=False)
    temporary.write_text(text + "\n", encoding="utf-8")
    os.replace(temporary, out / "run.json")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
