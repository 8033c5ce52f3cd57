"""Forward-mode derivatives: torch's rules for them, and directions in a kernel's layout."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
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


def slopes(
    function: Callable[[Tensor], tuple[Tensor, ...]], at: Tensor, directions: Tensor
) -> tuple[Tensor | None, ...]:
    """Derivatives of several outputs in P directions, each of shape [P, ...]; None for outputs that stay.

    The gradient of the outputs is linear in its seeds, and the derivatives are the transpose of that linear map: two
    passes of reverse mode give all directions, where torch's forward mode takes milliseconds for each operation.

    Args:
        function: twice differentiable by torch.
        at: the input.
        directions: shape [P, *at.shape].
    """
    with torch.enable_grad():
        inputs = at.detach().requires_grad_()
        outputs = function(inputs)
        moving = [place for place, output in enumerate(outputs) if output.requires_grad]
        seeds = [torch.zeros_like(outputs[place], requires_grad=True) for place in moving]
        found: list[Tensor | None] = [None] * len(outputs)
        if not moving:
            return tuple(found)
        (pulled,) = torch.autograd.grad([outputs[place] for place in moving], inputs, seeds, create_graph=True)
        parts = torch.autograd.grad(pulled, seeds, directions, is_grads_batched=True, allow_unused=True)
    for place, part in zip(moving, parts, strict=True):
        found[place] = part
    return tuple(found)
