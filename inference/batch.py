"""Predict many clips: reading overlaps with the network, results are kept as they come."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

from inference.decoding import BackgroundReader, Failure, Reader, failure_from
from inference.gallery import write_gallery
from inference.loading import ClipSettings
from inference.naming import assign_names
from inference.pictures import ClipPictures
from inference.prediction import Prediction
from inference.predictor import load_predictor
from inference.preparing import Predictor, ReadyClip, ready_source, to_prediction
from inference.read_ahead import read_ahead
from inference.results import ResultsFolder
from inference.run_record import checkpoint_digest, finish_run, start_run
from inference.sources import ClipSource, Found, SourceProblem, displayed_path, find_sources, fingerprint
from inference.table import ResultRow
from inference.weight_maps import weight_maps
from inference.worker import WorkerReader
from physconvex.errors import InputError

__all__ = ["BatchOptions", "BatchSummary", "ClipResult", "iter_predictions", "predict_batch"]

_LEAST_CLIPS_FOR_PROCESSES = 4  # below it, starting processes takes longer than reading

Paths = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]


@dataclass(frozen=True, kw_only=True)
class BatchOptions:
    """How the work is done; none of it changes a prediction."""

    batch_size: int = 8
    """Most clips in one pass of the network."""
    workers: int | None = None
    """Clips read at once; None: two, or one on a single core."""
    processes: bool = True
    """Read in worker processes, so that a codec that crashes takes one clip with it; else in threads."""

    def __post_init__(self) -> None:
        """Check that both are positive whole numbers.

        Raises:
            InputError: one is not.
        """
        for name in ("batch_size", "workers"):
            value = getattr(self, name)
            if value is not None and (not isinstance(value, int) or value < 1):
                raise InputError(f"{name} is {value!r}; expected a whole number of at least 1.")

    @property
    def readers(self) -> int:
        """Number of clips read at once."""
        return self.workers or min(2, os.cpu_count() or 1)


@dataclass(frozen=True, eq=False)
class ClipResult:
    """What came of one clip: a prediction or an error."""

    source: ClipSource | SourceProblem
    prediction: Prediction | None
    error: str = ""
    """One line that names the file and the cause; empty if there is a prediction."""
    details: str = ""
    """Trace of an unexpected error."""
    pictures: ClipPictures = field(default_factory=ClipPictures)
    """What to look at; empty unless asked for."""


@dataclass(frozen=True, kw_only=True)
class BatchSummary:
    """What came of a batch."""

    out: Path
    rows: tuple[ResultRow, ...]
    """The clips of this run, in the order they were found."""
    predicted: int
    """Clips predicted in this run."""
    resumed: int
    """Clips that an earlier run had finished."""
    failed: int
    """Clips without prediction."""

    @property
    def exit_code(self) -> int:
        """0 if every clip has a prediction, else 1."""
        return 1 if self.failed else 0


def iter_predictions(
    paths: Paths,
    *,
    fps: float | None = None,
    density: float | None = None,
    object_size: float | None = None,
    predictor: Predictor | None = None,
    checkpoint: str | os.PathLike[str] = "default",
    device: str = "cpu",
    batch_size: int = 8,
    workers: int | None = None,
    processes: bool = True,
) -> Iterator[ClipResult]:
    """Predict every clip at or below `paths`, each as soon as it is ready (not in order).

    Reading runs in the background. A bad clip gives a result with an `error` and the others go on.
    See `predict` for the arguments that are not explained here, `find_sources` for what counts as a clip.

    Raises:
        InputError: an option is bad or there is no such checkpoint (raised at once, not while iterating).
    """
    settings = ClipSettings(fps=fps, density=density, object_size=object_size)
    options = BatchOptions(batch_size=batch_size, workers=workers, processes=processes)
    if predictor is None:
        predictor = load_predictor(os.fspath(checkpoint), device)
    return _results(find_sources(_as_list(paths)), settings, predictor, options)


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
    """Predict every clip at or below `paths` and write the results to the folder `out` as they come.

    What an earlier run finished with the same clip, settings and checkpoint is kept; errors are tried again.
    Nothing finished is lost if the process is killed. See `inference.results` for the files.

    Args:
        paths: video files, capture folders, image folders, or folders of these.
        out: folder of the results; it is skipped if it lies below `paths`.
        redo: predict finished clips again.
        command: command line to keep beside the results; None: that of the process.
        on_start: called once with the number of clips.
        on_row: called with each row as it is written, also for clips finished earlier.
        fps, density, object_size, predictor, checkpoint, device: see `predict`.
        batch_size: most clips in one pass of the network.
        workers: clips read at once; None: two, or one on a single core.
        processes: read in worker processes (four clips or more), so that a codec that crashes takes one clip
            with it; else in threads.

    Raises:
        InputError: an option is bad, there is no such checkpoint, or `out` cannot be written.
    """
    settings = ClipSettings(fps=fps, density=density, object_size=object_size)
    options = BatchOptions(batch_size=batch_size, workers=workers, processes=processes)
    found = find_sources(_as_list(paths), exclude=[out])
    if predictor is None:
        predictor = load_predictor(os.fspath(checkpoint), device)
    digest = _settings_digest(settings, predictor)
    with ResultsFolder(out, settings=digest) as folder:
        record = start_run(
            folder.path,
            command=command,
            configuration={
                "paths": [displayed_path(path) for path in _as_list(paths)],
                **asdict(settings),
                **asdict(options),
                "readers": options.readers,
                "checkpoint": displayed_path(checkpoint),
                "checkpoint_digest": checkpoint_digest(predictor),
                "device": device,
                "redo": redo,
            },
        )
        batch = _Batch(folder, found, redo=redo, on_row=on_row)
        if on_start is not None:
            on_start(len(found))
        batch.report_finished()
        for result in _results(batch.to_do, settings, predictor, options, picture=True):
            batch.add(result)
        rows = folder.finish([item.key for item in found])[: len(found)]
        summary = batch.summary(rows)
        write_gallery(folder.path, rows)
        finish_run(folder.path, record, predicted=summary.predicted, resumed=summary.resumed, failed=summary.failed)
    return summary


class _Batch:
    """Which clips are finished, which are to do, and what became of them."""

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
        """Write a result; one that cannot be written as a prediction is written as an error."""
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
        else:
            self.predicted += 1
        self._report(row)

    def summary(self, rows: tuple[ResultRow, ...]) -> BatchSummary:
        """Return the counts with the rows of this run."""
        return BatchSummary(
            out=self._folder.path,
            rows=rows,
            predicted=self.predicted,
            resumed=len(self.finished),
            failed=self.failed,
        )

    def _report(self, row: ResultRow) -> None:
        if self._on_row is not None:
            self._on_row(row)


def _results(
    found: Sequence[Found],
    settings: ClipSettings,
    predictor: Predictor,
    options: BatchOptions,
    *,
    picture: bool = False,
) -> Iterator[ClipResult]:
    """Yield every result; reading and the network work ahead while the consumer writes."""
    for item in found:
        if isinstance(item, SourceProblem):
            yield ClipResult(item, None, f"{displayed_path(item.path)}: {item.cause}")
    clips = [item for item in found if isinstance(item, ClipSource)]
    yield from read_ahead(
        _predicted(clips, settings, predictor, options, picture=picture), depth=2 * options.batch_size
    )


def _predicted(
    clips: Sequence[ClipSource],
    settings: ClipSettings,
    predictor: Predictor,
    options: BatchOptions,
    *,
    picture: bool,
) -> Generator[ClipResult, None, None]:

    def make_reader() -> Reader:
        if options.processes and len(clips) >= _LEAST_CLIPS_FOR_PROCESSES:
            return WorkerReader(settings, predictor.clip_config, picture=picture)
        return partial(ready_source, settings=settings, prepare=predictor.prepare, picture=picture)

    reader = BackgroundReader(clips, make_reader, workers=options.readers, ahead=options.batch_size + options.readers)
    try:
        for batch in reader.batches(options.batch_size):
            for failure in (item for item in batch if isinstance(item, Failure)):
                yield ClipResult(failure.source, None, failure.error, failure.details)
            yield from _estimate([item for item in batch if isinstance(item, ReadyClip)], predictor)
    finally:
        reader.close()


def _estimate(ready: Sequence[ReadyClip], predictor: Predictor) -> Iterator[ClipResult]:
    """Run the network; a batch that fails is halved until the clip that fails is alone."""
    if not ready:
        return
    try:
        estimates = predictor.estimate(
            [clip.prepared for clip in ready],
            density=[clip.conditions.density for clip in ready],
            object_size=[clip.conditions.object_size for clip in ready],
        )
        predictions = [to_prediction(*pair) for pair in zip(ready, estimates, strict=True)]
    except Exception as error:  # one bad clip must not end the batch; it is reported with its trace
        if len(ready) > 1:
            middle = len(ready) // 2
            yield from _estimate(ready[:middle], predictor)
            yield from _estimate(ready[middle:], predictor)
            return
        source = ready[0].source
        assert source is not None
        failure = failure_from(source, error)
        yield ClipResult(source, None, failure.error, failure.details)
        return
    for clip, prediction in zip(ready, predictions, strict=True):
        assert clip.source is not None
        yield ClipResult(clip.source, prediction, pictures=_pictures(clip, prediction))


def _pictures(clip: ReadyClip, prediction: Prediction) -> ClipPictures:
    if not clip.picture:
        return ClipPictures()
    maps = weight_maps(prediction.skinning_field, clip.prepared.mask[0], prediction.object_size)
    return ClipPictures(frames=clip.picture, weights=maps)


def _as_list(paths: Paths) -> list[str | os.PathLike[str]]:
    return [paths] if isinstance(paths, str | os.PathLike) else list(paths)


def _fingerprint_or_empty(source: ClipSource) -> str:
    try:
        return fingerprint(source)
    except OSError:
        return ""  # reading it will tell why


def _settings_digest(settings: ClipSettings, predictor: Predictor) -> str:
    text = json.dumps([asdict(settings), checkpoint_digest(predictor)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
