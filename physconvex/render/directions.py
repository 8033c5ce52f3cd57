"""Forward-mode derivatives: torch's rules for them, and directions in a kernel's layout."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import cache

import torch
from torch import Tensor
from torch.autograd import forward_ad

Directions = Sequence[tuple[Tensor | None, ...]]
"""For each direction the derivatives of the coordinates and of `Splats.differentiable`, or None if they are zero."""


@cache
def load_forward_mode() -> None:
    """Load torch's forward-mode rules without the warning (in 2.15) about its own use of `torch.jit.script`."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".torch.jit.script. is deprecated", category=FutureWarning)
        with forward_ad.dual_level():
            forward_ad.make_dual(torch.zeros(1), torch.zeros(1))


def stacked(directions: Directions, inputs: Sequence[Tensor]) -> list[Tensor]:
    """For each input its derivatives in all directions, in the layout of the input."""
    found = []
    for tensor, parts in zip(inputs, zip(*directions, strict=True), strict=True):
        out = tensor.new_zeros((len(parts), *tensor.shape))
        for row, part in zip(out, parts, strict=True):
            if part is not None:
                row.copy_(part.detach())
        found.append(out)
    return found
