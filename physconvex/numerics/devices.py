"""Torch devices by name."""

from __future__ import annotations

import torch

from physconvex.errors import InputError

__all__ = ["device_named"]


def device_named(name: str) -> torch.device:
    """The device of a name such as "cpu" or "cuda:0".

    Raises:
        InputError: there is none, or it cannot be used here.
    """
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise InputError(f"device: {name!r} cannot be used ({error}); try 'cpu'") from error
    return device
