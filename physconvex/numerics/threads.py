"""One thread of torch for arithmetic on small matrices."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

__all__ = ["one_torch_thread"]


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Torch computes on one thread inside, as a `with` block or a decorator, and sums in one order on every machine.

    A time step is thousands of operations on small matrices. Torch's threads and those of numpy's BLAS, waiting for
    each other at every one of them, make a roll-out on two cores two to eight times as slow as one thread does.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
