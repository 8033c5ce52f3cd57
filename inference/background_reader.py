"""Read and prepare clips in the background, parallel to the network: in threads, or in processes of their own.

A codec that crashes in a process loses one clip, not the batch. A worker starts fresh (without a fork of a threaded
process or a second run of the user's script), receives one source at a time over a pipe and returns the network's
input. It ends when the pipe closes, also when the parent is killed.
"""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection, Pipe

import cv2

from inference.preparation import ReadyClip, ready_source
from inference.settings import StatedConditions
from inference.sources import ClipSource, displayed_path
from models import ClipConfig, prepare_clip
from physconvex import InputError, PhysconvexError

_START = "import sys; sys.path[:] = {path!r}; from inference.background_reader import serve; serve({descriptor})"


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


class ReaderCrashError(PhysconvexError, RuntimeError):
    """The process that read a clip died."""


class WorkerReader:
    """Reads clips in a worker process, which restarts after a crash."""

    def __init__(self, settings: StatedConditions, config: ClipConfig, *, picture: bool) -> None:
        self._task = (settings, config, picture)
        self._process: subprocess.Popen[bytes] | None = None

    def __call__(self, source: ClipSource) -> ReadyClip | Failure:
        """Return the clip as the network's input, or the reason why it cannot be read.

        Raises:
            ReaderCrashError: the worker crashed on this clip.
        """
        if self._process is None:
            self._start()
        try:
            self._pipe.send(source)
            outcome: ReadyClip | Failure = self._pipe.recv()
        except (EOFError, BrokenPipeError, ConnectionResetError):
            raise ReaderCrashError(self._describe_death()) from None
        return outcome

    def close(self) -> None:
        """End the worker."""
        if self._process is not None:
            self._pipe.close()
            self._process.wait()
            self._log.close()
            self._process = None

    def _start(self) -> None:
        self._pipe, theirs = Pipe()
        self._log = tempfile.TemporaryFile()  # exists as long as the worker
        code = _START.format(path=sys.path, descriptor=theirs.fileno())
        self._process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=self._log,
            pass_fds=[theirs.fileno()],
            env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        theirs.close()
        try:
            self._pipe.send(self._task)
        except (BrokenPipeError, ConnectionResetError):
            raise ReaderCrashError(self._describe_death()) from None

    def _describe_death(self) -> str:
        assert self._process is not None
        self._pipe.close()
        code = self._process.wait()
        self._log.seek(0)
        said = self._log.read().decode("utf-8", "replace").strip().splitlines()
        self._log.close()
        self._process = None
        how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        return f"the process that read it died ({how})" + (f": {said[-1]}" if said else "")


def serve(descriptor: int) -> None:
    """Run a worker on an inherited pipe: read sources until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C and closes the pipe
    cv2.setNumThreads(1)
    with Connection(descriptor) as pipe:
        settings, config, picture = pipe.recv()
        prepare = partial(prepare_clip, config=config)
        while True:
            try:
                source: ClipSource = pipe.recv()
            except (EOFError, ConnectionResetError):
                return
            try:
                outcome: ReadyClip | Failure = ready_source(source, settings, prepare, picture=picture)
            except Exception as error:  # reported to the parent with its trace
                outcome = failure_from(source, error)
            pipe.send(outcome)
