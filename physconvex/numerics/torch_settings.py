"""Torch's devices by name, and one thread of it for arithmetic on small matrices."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from physconvex.errors import InputError


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Torch computes on one thread inside, as a `with` block or a decorator, and sums in one order on every machine.

    A time step has thousands of operations on small matrices. Torch's threads and those of numpy's BLAS wait for each
    other at every one of them, which makes a roll-out on two cores two to eight times as slow as one thread.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def device_named(name: str) -> torch.device:
    """The device of a name such as "cpu" or "cuda:0".

    Raises:
        InputError: there is none, or it is not usable here.
    """
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise InputError(f"device: {name!r} cannot be used ({error}); try 'cpu'") from error
    return device
