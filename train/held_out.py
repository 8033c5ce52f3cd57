"""Held-out clips as inference would read them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import physconvex
from models import ClipEstimate, PhysicsPredictor, PreparedClip
from train.cache import PreparedClips, prepare_clips
from train.options import EvaluationOptions, Shown
from train.progress import Report
from train.records import LabelledClip, dataset_checksum, read_clips

_BATCH = 16


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Clips with their labels, prepared with the foreground that inference finds."""

    labels: list[LabelledClip]
    prepared: PreparedClips

    def __len__(self) -> int:
        return len(self.labels)


@dataclass(frozen=True, eq=False)
class Evaluated:
    """What an evaluation is of."""

    checkpoint: str
    split: str
    data: dict[str, str]
    """Manifest checksums."""

    def write(self, path: Path, content: dict[str, object]) -> None:
        """A JSON file of this and what was found, with the command."""
        path.parent.mkdir(parents=True, exist_ok=True)
        tree = {
            "command": "physconvex " + " ".join(sys.argv[1:]),
            "version": physconvex.__version__,
            "checkpoint": self.checkpoint,
            "split": self.split,
            "data": self.data,
        }
        path.write_text(json.dumps(tree | content, indent=1) + "\n", encoding="utf-8")


def evaluated_clips(
    data: Sequence[Path | str], options: EvaluationOptions, *, out: Path, report: Report | None = None
) -> tuple[Evaluated, PhysicsPredictor, HeldOut]:
    """What is evaluated: the predictor and its input clips.

    These are cached in `out/cache` unless the options give another place.
    """
    predictor = PhysicsPredictor.from_pretrained(options.checkpoint, device=options.device)
    clips = held_out(
        data, predictor, split=options.split, cache=options.cache or out / "cache", limit=options.limit,
        workers=options.workers, report=report,
    )  # fmt: skip
    checksums = {str(folder): dataset_checksum(folder) for folder in data}
    return Evaluated(options.checkpoint, options.split, checksums), predictor, clips


def held_out(
    data: Sequence[Path | str],
    predictor: PhysicsPredictor,
    *,
    split: Shown,
    cache: Path,
    limit: int | None = None,
    workers: int = 1,
    report: Report | None = None,
) -> HeldOut:
    """The clips of a split, at most `limit`, spread over it evenly."""
    labels = read_clips(data, None if split == "all" else split)
    if limit is not None and limit < len(labels):
        labels = [labels[k] for k in np.linspace(0, len(labels) - 1, limit).round().astype(int)]
    progress = None if report is None else lambda done, total: report("preparing clips", done, total)
    return HeldOut(labels, prepare_clips(labels, predictor.config.clip, cache, workers=workers, progress=progress))


def held_out_estimates(
    predictor: PhysicsPredictor,
    clips: HeldOut,
    *,
    change: Callable[[PreparedClip], PreparedClip] = lambda clip: clip,
    report: Callable[[int, int], None] | None = None,
) -> Iterator[ClipEstimate]:
    """One estimate per clip, after `change`."""
    for first in range(0, len(clips), _BATCH):
        chosen = range(first, min(first + _BATCH, len(clips)))
        labels = [clips.labels[k] for k in chosen]
        yield from predictor.estimate(
            [change(clips.prepared.clip(k)) for k in chosen],
            density=[label.density for label in labels],
            object_size=[label.object_size for label in labels],
        )
        if report is not None:
            report(chosen[-1] + 1, len(clips))
