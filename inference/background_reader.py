"""Read and prepare clips in the background, parallel to the network."""

from __future__ import annotations

import queue
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from inference.preparation import ReadyClip
from inference.sources import ClipSource, displayed_path
from physconvex import InputError


@dataclass(frozen=True)
class Failure:
    """Why one clip has no prediction."""

    source: ClipSource
    error: str
    """One line that names the file and the cause."""
    details: str = ""
    """Trace of an unexpected error; empty for bad input."""


Reader = Callable[[ClipSource], ReadyClip | Failure]
"""Reads one clip; may raise. A reader with a method `close` is closed at the end."""


def failure_from(source: ClipSource, error: Exception) -> Failure:
    """Convert any exception of one clip to one line; unexpected ones keep their trace."""
    path = displayed_path(source.path)
    text = " ".join(str(error).split())
    if isinstance(error, InputError):
        return Failure(source, text if path in text else f"{path}: {text}")
    details = "".join(traceback.format_exception(error))
    return Failure(source, f"{path}: unexpected {type(error).__name__}: {text or 'no message'}", details)


class BackgroundReader:
    """Threads that read clips ahead of the network, at most `ahead` of them waiting.

    Each thread calls its own reader from `make_reader`, which reads in the thread or in a worker process. The order is
    that of completion.
    """

    def __init__(
        self,
        sources: Sequence[ClipSource],
        make_reader: Callable[[], Reader],
        *,
        workers: int,
        ahead: int,
    ) -> None:
        self._pending = iter(sources)
        self._left = len(sources)
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._done: queue.Queue[ReadyClip | Failure] = queue.Queue(maxsize=max(1, ahead))
        self._threads = [
            threading.Thread(target=self._work, args=(make_reader,), name=f"clip-reader-{k}", daemon=True)
            for k in range(min(workers, len(sources)))
        ]
        for thread in self._threads:
            thread.start()

    def batches(self, size: int) -> Iterator[list[ReadyClip | Failure]]:
        """Yield the available clips, at least one and at most `size` at a time, until all are read."""
        while self._left:
            batch = [self._done.get()]
            while len(batch) < min(size, self._left):
                try:
                    batch.append(self._done.get_nowait())
                except queue.Empty:
                    break
            self._left -= len(batch)
            yield batch

    def close(self) -> None:
        """Stop reading: clips under way are finished and dropped."""
        self._stop.set()
        while alive := [thread for thread in self._threads if thread.is_alive()]:
            while not self._done.empty():  # makes room for a thread that waits to hand over its clip
                self._done.get_nowait()
            alive[0].join(timeout=0.05)

    def _next(self) -> ClipSource | None:
        with self._lock:
            return None if self._stop.is_set() else next(self._pending, None)

    def _work(self, make_reader: Callable[[], Reader]) -> None:
        read = make_reader()
        try:
            while (source := self._next()) is not None:
                try:
                    outcome: ReadyClip | Failure = read(source)
                except Exception as error:  # one bad clip must not end the batch; it is reported with its trace
                    outcome = failure_from(source, error)
                self._done.put(outcome)
        finally:
            close = getattr(read, "close", None)
            if close is not None:
                close()
