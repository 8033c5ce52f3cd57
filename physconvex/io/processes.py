"""Worker processes: what they start with, and that they do not outlive the program that started them."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

# One thread; and MKL's conditional reproducibility, without which sums depend on where arrays lie in memory.
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_CBWR": "AUTO",
}


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes started inside use one thread each and give the same bits every time.

    Several with as many threads as there are cores hinder each other: two on two cores took three times as long.
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
    """Initialiser of a worker process: it ends as soon as its parent has, even if that was killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, name="end_with_parent", daemon=True).start()
