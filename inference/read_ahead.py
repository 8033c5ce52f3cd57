"""Runs an iterator ahead of its consumer, in a thread."""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator, Iterator
from contextlib import suppress
from typing import TypeVar

Item = TypeVar("Item")


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
