"""The results folder: a kill-safe journal, one set of files per clip, CSV and Parquet tables.

```
clips/NAME.json                   the prediction with its units
clips/NAME.skinning.safetensors   the skinning field
clips/NAME.jpg                    frames that were used, with the outline of the object
clips/NAME.skinning.png           section through the skinning weights
journal.jsonl                     one line per finished or failed clip, written after its files
predictions.csv, .parquet         the table
run.json                          configuration, versions and command of every run
```
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import TextIO

from inference.pictures import ClipPictures
from inference.prediction import Prediction
from inference.sources import ClipSource, SourceProblem, displayed_path
from inference.table import ResultRow, row_of_error, row_of_prediction, write_csv, write_parquet
from physconvex import InputError
from physconvex.io import whole_file

_UNSAFE = re.compile(r"[^\w.+-]+", re.UNICODE)
_MAX_BYTES = 120  # leaves room for suffixes below the 255 bytes that file systems allow


@dataclass(frozen=True)
class JournalEntry:
    """Journal entry of one clip."""

    key: str
    """Absolute path of the clip."""
    fingerprint: str
    """Digest of the clip's file sizes and times; empty if they are unavailable."""
    settings: str
    """Digest of everything besides the clip that affects the prediction."""
    row: ResultRow
    details: str = ""
    """Trace of an unexpected error."""
    sizes: list[int] = field(default_factory=list)
    """Sizes of the JSON and the skinning file [bytes]: only the journal is synced, so a power cut may empty them."""


class ResultsFolder:
    """Writes each result at once; a clip's files are complete on disk before its journal line.

    One process at a time: a lock on the journal, which the system releases even after a kill.
    """

    def __init__(self, out: str | os.PathLike[str], *, settings: str) -> None:
        self.path = Path(out)
        self._settings = settings
        try:
            (self.path / "clips").mkdir(parents=True, exist_ok=True)
            self._journal = open(self.path / "journal.jsonl", "a+", encoding="utf-8")
        except OSError as error:
            raise InputError(
                f"out is {str(out)!r}; expected a folder that can be written ({error.strerror}). Name another one."
            ) from error
        self._lock()
        self._entries = self._read_journal()
        self._csv: TextIO | None = None
        self._write_tables(())

    def __enter__(self) -> ResultsFolder:
        """Return the folder itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Release the journal."""
        if self._csv is not None:
            self._csv.close()
        self._journal.close()

    @property
    def names(self) -> dict[str, str]:
        """Result names given so far, by key."""
        return {key: entry.row.name for key, entry in self._entries.items() if entry.row.name}

    def finished(self, key: str, fingerprint: str) -> ResultRow | None:
        """Return the row of a clip predicted with the same content and settings, else None."""
        entry = self._entries.get(key)
        if entry is None or entry.row.error or (entry.fingerprint, entry.settings) != (fingerprint, self._settings):
            return None
        paths = (self.record_path(entry.row.name), self.skinning_path(entry.row.name))
        sizes = [path.stat().st_size for path in paths if path.is_file()]
        return entry.row if sizes == entry.sizes else None

    def record_path(self, name: str) -> Path:
        """Return the JSON file of a clip."""
        return self.path / "clips" / f"{name}.json"

    def skinning_path(self, name: str) -> Path:
        """Return the skinning file of a clip."""
        return self.path / "clips" / f"{name}.skinning.safetensors"

    def add_prediction(
        self, source: ClipSource, name: str, fingerprint: str, prediction: Prediction, pictures: ClipPictures
    ) -> ResultRow:
        """Write a prediction's files, then its journal line, then its line in the CSV."""
        row = row_of_prediction(name, prediction)
        record = prediction.to_record() | {"name": name, "skinning_weights": self.skinning_path(name).name}
        skinning_size = self._write(self.skinning_path(name), prediction.skinning_field.save)
        for suffix, data in ((".jpg", pictures.frames), (".skinning.png", pictures.weights)):
            if data:
                self._write_bytes(self.path / "clips" / f"{name}{suffix}", data)
        text = json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        sizes = [self._write_bytes(self.record_path(name), text.encode()), skinning_size]
        self._append(JournalEntry(source.key, fingerprint, self._settings, row, sizes=sizes))
        return row

    def add_error(self, source: ClipSource | SourceProblem, name: str, error: str, *, details: str = "") -> ResultRow:
        """Record that a clip has no prediction, and why."""
        row = row_of_error(name, displayed_path(source.path), error)
        self._append(JournalEntry(source.key, "", self._settings, row, details))
        return row

    def finish(self, order: Sequence[str]) -> tuple[ResultRow, ...]:
        """Rewrite both tables: clips of this run in the order of their keys, then those of earlier runs."""
        return self._write_tables(order, parquet=True)

    def _lock(self) -> None:
        try:
            fcntl.flock(self._journal, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._journal.close()
            raise InputError(
                f"out is {str(self.path)!r}, where another run is writing. Wait for it, or name another one."
            ) from None

    def _read_journal(self) -> dict[str, JournalEntry]:
        """Return the last entry of each clip; a line truncated by a kill is dropped and its clip repeated."""
        self._journal.seek(0)
        entries = {}
        torn = False
        for line in self._journal:
            torn = not line.endswith("\n")
            try:
                values = json.loads(line)
                entry = JournalEntry(**(values | {"row": ResultRow.from_values(values["row"])}))
            except (ValueError, TypeError, KeyError):
                continue
            entries[entry.key] = entry
        if torn:
            self._journal.write("\n")
        return entries

    def _append(self, entry: JournalEntry) -> None:
        self._entries[entry.key] = entry
        self._journal.write(json.dumps(asdict(entry), ensure_ascii=True) + "\n")
        self._journal.flush()
        os.fsync(self._journal.fileno())
        assert self._csv is not None
        write_csv(self._csv, [entry.row], header=False)
        self._csv.flush()

    def _write_bytes(self, path: Path, data: bytes) -> int:
        return self._write(path, lambda target: target.write_bytes(data))

    def _write(self, path: Path, write: Callable[[Path], object]) -> int:
        """Write, whole or not at all; return the size [bytes]."""
        with whole_file(path) as partial:
            write(partial)
            return partial.stat().st_size

    def _write_tables(self, order: Sequence[str], *, parquet: bool = False) -> tuple[ResultRow, ...]:
        rows = tuple(self._ordered_rows(order))
        path = self.path / "predictions.csv"
        if parquet:
            self._write(self.path / "predictions.parquet", lambda target: write_parquet(target, rows))
        if self._csv is not None:
            self._csv.close()
        with whole_file(path) as partial, open(partial, "w", encoding="utf-8", newline="") as file:
            write_csv(file, rows, header=True)
        self._csv = open(path, "a", encoding="utf-8", newline="")
        return rows

    def _ordered_rows(self, order: Sequence[str]) -> Iterable[ResultRow]:
        yield from (self._entries[key].row for key in order if key in self._entries)
        chosen = set(order)
        for key, entry in self._entries.items():
            gone = bool(order) and bool(entry.row.error) and not os.path.lexists(key)
            if key not in chosen and not gone:
                yield entry.row


def assign_names(sources: Iterable[ClipSource], taken: Mapping[str, str]) -> dict[str, str]:
    """Return one result name per source key; a name in `taken` (key → name, from earlier runs) is kept.

    `sub/clip.mp4` becomes `sub__clip`; if two clips have the same name, the later one gets a digest of its path.
    """
    names = dict(taken)
    used = {name.casefold() for name in names.values()}
    for source in sources:
        if source.key in names:
            continue
        name = _readable(source)
        if name.casefold() in used:
            name = f"{name}-{_digest(source)}"
        names[source.key] = name
        used.add(name.casefold())
    return names


def _readable(source: ClipSource) -> str:
    name = _UNSAFE.sub("_", source.title.replace("/", "__")).strip("._") or "clip"
    if len(name.encode("utf-8", "replace")) <= _MAX_BYTES:
        return name
    short = name.encode("utf-8", "replace")[:_MAX_BYTES].decode("utf-8", "ignore")
    return f"{short}-{_digest(source)}"


def _digest(source: ClipSource) -> str:
    return hashlib.sha256(source.key.encode()).hexdigest()[:10]
