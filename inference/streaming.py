"""Predict clips as a stream: reading, the network and the consumer run in parallel."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

from inference.background_reader import BackgroundReader, Failure, Reader, WorkerReader, failure_from
from inference.pictures import ClipPictures, weight_maps
from inference.prediction import Prediction
from inference.predictor import load_predictor
from inference.preparation import Predictor, ReadyClip, ready_source, to_prediction
from inference.settings import BatchOptions, StatedConditions
from inference.sources import ClipSource, Found, SourceProblem, displayed_path, find_sources

_LEAST_CLIPS_FOR_PROCESSES = 4  # below it, starting processes takes longer than reading

Item = TypeVar("Item")
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


class _End:
    """Ends the queue; carries the exception of the iterator, if any."""

    def __init__(self, error: BaseException | None) -> None:
        self.error = error


def read_ahead(items: Generator[Item, None, None], *, depth: int) -> Iterator[Item]:
    """Yield the same items in the same order, computed in a thread at most `depth` items ahead.

    Exceptions of the generator are raised here. An early exit closes the generator, in its thread.
    """
    ready: queue.Queue[Item | _End] = queue.Queue(maxsize=depth)
    stop = threading.Event()

    def work() -> None:
        error: BaseException | None = None
        try:
            for item in items:
                ready.put(item)
                if stop.is_set():
                    break
        except BaseException as problem:  # handed to the consumer, who raises it
            error = problem
        finally:
            items.close()
            ready.put(_End(error))

    thread = threading.Thread(target=work, name="clip-network", daemon=True)
    thread.start()
    try:
        while not isinstance(item := ready.get(), _End):
            yield item
        if item.error is not None:
            raise item.error
    finally:
        stop.set()
        while thread.is_alive():
            with suppress(queue.Empty):
                ready.get(timeout=0.02)
        thread.join()
