"""Reads clips in a separate process: a crashing codec loses one clip, not the batch.

A worker starts fresh (without a fork of a threaded process or a second run of the user's script), receives one source
at a time over a pipe and returns the network's input. It ends when the pipe closes, also when the parent is killed.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from functools import partial
from multiprocessing.connection import Connection, Pipe

import cv2

from inference.background_reader import Failure, failure_from
from inference.preparation import ReadyClip, ready_source
from inference.settings import StatedConditions
from inference.sources import ClipSource
from models import ClipConfig, prepare_clip
from physconvex import PhysconvexError

_START = "import sys; sys.path[:] = {path!r}; from inference.reading_process import serve; serve({descriptor})"


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
