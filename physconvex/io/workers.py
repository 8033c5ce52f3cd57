"""Worker processes: their settings, their end with the parent process, and independent calls in them."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from types import TracebackType
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
# One thread; and MKL's conditional reproducibility, without which sums depend on the memory alignment of arrays.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_CBWR": "AUTO"}


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes started inside use one thread each and give bit-identical results.

    Several processes with as many threads as cores slow each other down: two on two cores take three times as long.
    """
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def end_with_parent() -> None:
    """Initialiser of a worker process: it ends with its parent, even if that is killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, name="end_with_parent", daemon=True).start()


class Workers:
    """Processes that start with the first parallel call and end with the block.

    Functions, arguments and results must be picklable. A worker computes with one thread and imports the program's main
    module, like all Python worker processes. If a worker dies, its calls run in this process instead.

    Args:
        processes: how many; 1: every call runs in this process.
    """

    def __init__(self, processes: int = 1) -> None:
        self.processes = processes
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    @property
    def running(self) -> bool:
        """Whether processes have been started."""
        return self._pool is not None

    def begin(self, calls: int) -> None:
        """Start processes for that many calls in advance: their imports take seconds."""
        for _ in range(min(self.processes, calls) if self.processes > 1 else 0):
            self.start(os.getpid)

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """The results of a function, in order; parallel if there are several items."""
        items = list(items)
        if self.processes == 1 or len(items) < 2:
            return [function(item) for item in items]
        return [wait() for wait in [self.start(partial(function, item)) for item in items]]

    def start(self, function: Callable[[], Result]) -> Callable[[], Result]:
        """Begin a call; the returned function waits for its result. With one process, it runs the call itself."""
        if self.processes == 1:
            return function
        try:
            # as bytes, since torch would share its tensors' memory with the other process
            with one_thread_each():  # a process starts with its first task
                future = self._started().submit(_from_bytes, pickle.dumps(function))
        except BrokenProcessPool:
            return partial(self._here, function)
        return partial(self._awaited, future, function)

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                self.processes, mp_context=multiprocessing.get_context("spawn"), initializer=_prepared
            )
        return self._pool

    def _awaited(self, future: Future[Any], function: Callable[[], Result]) -> Result:
        try:
            return pickle.loads(future.result())
        except BrokenProcessPool:
            return self._here(function)

    def _here(self, function: Callable[[], Result]) -> Result:
        if self.processes > 1:
            warnings.warn("a worker process died: what it did is done one after the other", RuntimeWarning, 3)
            self.processes = 1
        return function()


def _prepared() -> None:
    import torch

    end_with_parent()
    torch.set_num_threads(1)


def _from_bytes(call: bytes) -> bytes:
    return pickle.dumps(pickle.loads(call)())
