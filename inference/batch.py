"""Predict many clips into a results folder; each result is written at once, and an interrupted run continues."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import platform
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import torch
from pydantic import JsonValue

from inference.background_reader import failure_from
from inference.gallery import write_gallery
from inference.predictor import load_predictor
from inference.preparation import Predictor
from inference.results import ResultsFolder, assign_names
from inference.settings import BatchOptions, StatedConditions
from inference.sources import ClipSource, Found, displayed_path, find_sources, fingerprint
from inference.streaming import ClipResult, Paths, as_list, stream_results
from inference.table import ResultRow
from physconvex import __version__
from physconvex.io import write_json

_LOG = logging.getLogger("physconvex")


@dataclass(frozen=True, kw_only=True)
class BatchSummary:
    """Result of a batch."""

    out: Path
    rows: tuple[ResultRow, ...]
    """The clips of this run, in the order they were found."""
    predicted: int
    """Clips predicted in this run."""
    resumed: int
    """Clips that an earlier run has finished."""
    failed: int
    """Clips without prediction."""

    @property
    def truncated(self) -> int:
        """Clips of this run that are predicted from the readable part of a truncated file."""
        return sum(bool(row.truncated) for row in self.rows)

    @property
    def exit_code(self) -> int:
        """0 if every clip has a prediction from its whole file, else 1."""
        return 1 if self.failed or self.truncated else 0


def predict_batch(
    paths: Paths,
    *,
    out: str | os.PathLike[str],
    fps: float | None = None,
    density: float | None = None,
    object_size: float | None = None,
    predictor: Predictor | None = None,
    checkpoint: str | os.PathLike[str] = "default",
    device: str = "cpu",
    batch_size: int = 8,
    workers: int | None = None,
    processes: bool = True,
    redo: bool = False,
    command: Sequence[str] | None = None,
    on_start: Callable[[int], None] | None = None,
    on_row: Callable[[ResultRow], None] | None = None,
) -> BatchSummary:
    """Predict every clip at or below `paths` and write each result to the folder `out` at once.

    Results of an earlier run with the same clip, settings and checkpoint are kept; errors are tried again. Finished
    results survive if the process is killed. See `inference.results` for the files.

    Args:
        paths: video files, capture folders, image folders, or folders of these.
        out: folder of the results; it is skipped if it lies below `paths`.
        redo: predict finished clips again.
        command: command line to store with the results; None: that of the process.
        on_start: called once with the number of clips.
        on_row: called with each row as it is written, also for clips finished earlier.
        fps, density, object_size, predictor, checkpoint, device: see `predict`.
        batch_size: most clips in one pass of the network.
        workers: clips read at once; None: two, or one on a single core.
        processes: read in worker processes (four clips or more), so that a crashing codec loses only its own clip; else
            in threads.

    Raises:
        InputError: an option is bad, there is no such checkpoint, or `out` cannot be written.
    """
    settings = StatedConditions(fps=fps, density=density, object_size=object_size)
    options = BatchOptions(batch_size=batch_size, workers=workers, processes=processes)
    found = find_sources(as_list(paths), exclude=[out])
    if predictor is None:
        predictor = load_predictor(os.fspath(checkpoint), device)
    digest = _settings_digest(settings, predictor)
    with ResultsFolder(out, settings=digest) as folder:
        record = _start_run(
            folder.path,
            command=command,
            configuration={
                "paths": [displayed_path(path) for path in as_list(paths)],
                **dict(settings),
                **dict(options),
                "readers": options.readers,
                "checkpoint": displayed_path(checkpoint),
                "checkpoint_digest": _checkpoint_digest(predictor),
                "device": device,
                "redo": redo,
            },
        )
        batch = _Batch(folder, found, redo=redo, on_row=on_row)
        if on_start is not None:
            on_start(len(found))
        _LOG.info("predict: %d clips, %d of them finished earlier", len(found), len(batch.finished))
        batch.report_finished()
        for result in stream_results(batch.to_do, settings, predictor, options, picture=True):
            batch.add(result)
        rows = folder.finish([item.key for item in found])[: len(found)]
        summary = BatchSummary(
            out=folder.path,
            rows=rows,
            predicted=batch.predicted,
            resumed=len(batch.finished),
            failed=batch.failed,
        )
        write_gallery(folder.path, rows)
        _finish_run(folder.path, record, predicted=summary.predicted, resumed=summary.resumed, failed=summary.failed)
    return summary


class _Batch:
    """State of the run: finished clips, remaining clips, and their outcomes."""

    def __init__(
        self,
        folder: ResultsFolder,
        found: Sequence[Found],
        *,
        redo: bool,
        on_row: Callable[[ResultRow], None] | None,
    ) -> None:
        self._folder, self._on_row = folder, on_row
        clips = [item for item in found if isinstance(item, ClipSource)]
        self._names = assign_names(clips, folder.names)
        self._fingerprints = {clip.key: _fingerprint_or_empty(clip) for clip in clips}
        kept = {} if redo else {c.key: folder.finished(c.key, self._fingerprints[c.key]) for c in clips}
        self.finished = {key: row for key, row in kept.items() if row is not None}
        self.to_do = [item for item in found if item.key not in self.finished]
        self.predicted = self.failed = 0

    def report_finished(self) -> None:
        """Report the rows of clips that an earlier run finished."""
        for row in self.finished.values():
            self._report(row)

    def add(self, result: ClipResult) -> None:
        """Write a result; one that cannot be written as a prediction becomes an error."""
        source, error, details = result.source, result.error, result.details
        name = self._names.get(source.key, "")
        row = None
        if result.prediction is not None and isinstance(source, ClipSource):
            try:
                row = self._folder.add_prediction(
                    source, name, self._fingerprints[source.key], result.prediction, result.pictures
                )
            except (ValueError, TypeError) as problem:  # such as a number that is not finite
                failure = failure_from(source, problem)
                error, details = failure.error, failure.details
        if row is None:
            row = self._folder.add_error(source, name, error, details=details)
            self.failed += 1
            _LOG.warning("predict: %s", error)
        else:
            self.predicted += 1
        self._report(row)

    def _report(self, row: ResultRow) -> None:
        if self._on_row is not None:
            self._on_row(row)


def _fingerprint_or_empty(source: ClipSource) -> str:
    try:
        return fingerprint(source)
    except OSError:
        return ""  # the reader reports the reason


def _settings_digest(settings: StatedConditions, predictor: Predictor) -> str:
    text = json.dumps([dict(settings), _checkpoint_digest(predictor)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _start_run(out: Path, *, command: Sequence[str] | None, configuration: Mapping[str, JsonValue]) -> int:
    """Add a run to `run.json` and return its number (a resumed batch has several runs)."""
    runs = _read_runs(out)
    runs.append(
        {
            "command": shlex.join(sys.argv if command is None else command),
            "started": _now(),
            "finished": None,
            "physconvex": __version__,
            "python": platform.python_version(),
            "torch": torch.__version__,
            "platform": platform.platform(),
            "configuration": dict(configuration),
        }
    )
    _write_runs(out, runs)
    return len(runs) - 1


def _finish_run(out: Path, number: int, **counts: int) -> None:
    """Record the end of a run and its counts; a killed run keeps `finished: null`."""
    runs = _read_runs(out)
    runs[number] |= {"finished": _now(), **counts}
    _write_runs(out, runs)


def _checkpoint_digest(predictor: Predictor) -> str:
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
    write_json(out / "run.json", {"schema": "physconvex/runs/1", "runs": runs})


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
