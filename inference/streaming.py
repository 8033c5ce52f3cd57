"""Predict clips as a stream: reading, the network and the consumer run in parallel."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

from inference.background_reader import BackgroundReader, Failure, Reader, failure_from
from inference.pictures import ClipPictures
from inference.prediction import Prediction
from inference.predictor import load_predictor
from inference.preparation import Predictor, ReadyClip, ready_source, to_prediction
from inference.read_ahead import read_ahead
from inference.reading_process import WorkerReader
from inference.settings import BatchOptions, StatedConditions
from inference.sources import ClipSource, Found, SourceProblem, displayed_path, find_sources
from inference.weight_pictures import weight_maps

_LEAST_CLIPS_FOR_PROCESSES = 4  # below it, starting processes takes longer than reading

Paths = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]


@dataclass(frozen=True, eq=False)
class ClipResult:
    """Result of one clip: a prediction or an error."""

    source: ClipSource | SourceProblem
    prediction: Prediction | None
    error: str = ""
    """One line that names the file and the cause; empty if there is a prediction."""
    details: str = ""
    """Trace of an unexpected error."""
    pictures: ClipPictures = field(default_factory=ClipPictures)
    """Pictures of the clip; empty unless requested."""


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

    Reading runs in the background. A bad clip gives a result with an `error`; the others continue. See `predict` for
    the other arguments and `find_sources` for the definition of a clip.

    Raises:
        InputError: an option is wrong or there is no such checkpoint (raised at once, not while iterating).
    """
    settings = StatedConditions(fps=fps, density=density, object_size=object_size)
    options = BatchOptions(batch_size=batch_size, workers=workers, processes=processes)
    if predictor is None:
        predictor = load_predictor(os.fspath(checkpoint), device)
    return stream_results(find_sources(as_list(paths)), settings, predictor, options)


def stream_results(
    found: Sequence[Found],
    settings: StatedConditions,
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
    settings: StatedConditions,
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
    """Run the network; a failing batch is halved until the failing clip is alone."""
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


def as_list(paths: Paths) -> list[str | os.PathLike[str]]:
    """Return one path or several as a list."""
    return [paths] if isinstance(paths, str | os.PathLike) else list(paths)
