"""Several jobs at once, each in a process of its own beside this one.

A worker is started fresh (no fork of a process with threads, no second run of the user's script), inherits the
environment, so that its libraries take as many threads as here and its results are the same to the last bit, and gets
one job at a time over a pipe. It ends when the pipe closes, so also when the parent is killed. Where a worker cannot be
started, or dies, its jobs are done here.
"""

from __future__ import annotations

import os
import pickle  # as it is: a pipe's own `send` would share the memory of torch's tensors
import signal
import subprocess
import sys
import threading
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, Pipe
from types import TracebackType
from typing import Any, TypeVar

from physconvex.errors import PhysconvexError

__all__ = ["Crew", "cores", "serve"]

_START = "import sys; sys.path[:] = {path!r}; from physconvex.crew import serve; serve({descriptor})"
_GRACE = 5.0  # seconds
Job = TypeVar("Job")
Result = TypeVar("Result")


def cores() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS
        return os.cpu_count() or 1


class Crew:
    """Processes that do jobs; started with the first batch of several.

    Args:
        size: how many jobs are done at once, this process counted in; None: as many as there are cores.
    """

    def __init__(self, size: int | None = None) -> None:
        self.size = max(1, cores() if size is None else size)
        self._workers: list[_Worker] = []

    def __enter__(self) -> Crew:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the workers; another batch starts new ones."""
        while self._workers:
            self._workers.pop().end()

    def run(
        self, function: Callable[[Job], Result], jobs: Sequence[Job], *, at_once: bool = True
    ) -> list[Result | PhysconvexError]:
        """What the function gives for each job, or the error of this package that it raised; all others are raised.

        Args:
            function: of a module, which workers import.
            jobs: must be picklable; so must the results.
            at_once: without it, one after the other in this process.
        """
        at_once = at_once and len(jobs) > 1
        if at_once:
            self._grow(min(self.size, len(jobs)) - 1)
        left, done = deque(enumerate(jobs)), {}
        given_back: list[tuple[int, Job]] = []

        def feed(worker: _Worker) -> None:
            while (item := _next(left)) is not None:
                try:
                    done[item[0]] = worker.do(function, item[1])
                except (EOFError, OSError):
                    given_back.append(item)
                    worker.dead = True
                    return

        helping = self._workers if at_once else []
        threads = [threading.Thread(target=feed, args=(worker,), daemon=True) for worker in helping]
        for thread in threads:
            thread.start()
        while (item := _next(left)) is not None:
            done[item[0]] = _outcome(function, item[1])
        for thread in threads:
            thread.join()
        self._bury()
        for number, job in given_back:
            done[number] = _outcome(function, job)
        results = [done[number] for number in range(len(jobs))]
        for result in results:
            if isinstance(result, BaseException) and not isinstance(result, PhysconvexError):
                raise result
        return results

    def _grow(self, count: int) -> None:
        try:
            while len(self._workers) < count:
                self._workers.append(_Worker())
        except (OSError, ValueError) as error:  # no memory, no processes, or a system without inherited pipes
            warnings.warn(f"no further process could be started ({error}): slower", RuntimeWarning, stacklevel=3)
            self.size = 1 + len(self._workers)

    def _bury(self) -> None:
        dead = [worker for worker in self._workers if worker.dead]
        if dead:
            warnings.warn("a worker process died; its job was done again here", RuntimeWarning, stacklevel=3)
            self.size = max(1, self.size - len(dead))
        for worker in dead:
            self._workers.remove(worker)
            worker.end()


class _Worker:
    """One process."""

    def __init__(self) -> None:
        self.dead = False
        self._pipe, theirs = Pipe()
        code = _START.format(path=sys.path, descriptor=theirs.fileno())
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", code], stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()]
            )
        finally:
            theirs.close()

    def do(self, function: Callable[[Any], Any], job: Any) -> Any:
        """The outcome of a job.

        Raises:
            EOFError, OSError: the process has died.
        """
        self._pipe.send_bytes(pickle.dumps((function, job)))
        return pickle.loads(self._pipe.recv_bytes())

    def end(self) -> None:
        self._pipe.close()
        self._process.terminate()
        try:
            self._process.wait(_GRACE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _next(left: deque[tuple[int, Any]]) -> tuple[int, Any] | None:
    try:
        return left.popleft()
    except IndexError:
        return None


def _outcome(function: Callable[[Any], Any], job: Any) -> Any:
    try:
        return function(job)
    except Exception as error:
        return error


def serve(descriptor: int) -> None:
    """Run a worker on an inherited pipe: do jobs until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business; it closes the pipe
    with Connection(descriptor) as pipe:
        while True:
            try:
                function, job = pickle.loads(pipe.recv_bytes())
                pipe.send_bytes(pickle.dumps(_outcome(function, job)))
            except (EOFError, ConnectionResetError, BrokenPipeError):
                return
