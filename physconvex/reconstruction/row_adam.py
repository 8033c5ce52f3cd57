"""Adam (Kingma & Ba 2015) for tensors whose rows are added and removed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Int
from torch import Tensor

DECAY, SQUARE_DECAY, SMALL = 0.9, 0.99, 1e-15


@dataclass
class RowAdam:
    """Moments of the gradients of tensors that share their first dimension (the convexes).

    The second moment decays faster (0.99) than usual, since with few views a convex is visible only every few steps.

    Attributes:
        first, second: moments, one of each per tensor, of its shape.
        steps: taken so far.
    """

    first: list[Tensor]
    second: list[Tensor]
    steps: int = 0

    @classmethod
    def of(cls, tensors: Sequence[Tensor]) -> RowAdam:
        """Before the first step."""
        first, second = ([torch.zeros_like(tensor, requires_grad=False) for tensor in tensors] for _ in range(2))
        return cls(first, second)

    def to(self, device: torch.device | str) -> RowAdam:
        """The moments on another device."""
        first, second = ([tensor.to(device) for tensor in group] for group in (self.first, self.second))
        return RowAdam(first, second, self.steps)

    @torch.no_grad()
    def step(self, tensors: Sequence[Tensor], rates: Sequence[Tensor | float]) -> None:
        """Move each tensor by its gradient; a rate is a number or a tensor that broadcasts."""
        self.steps += 1
        first_scale, second_scale = 1 - DECAY**self.steps, 1 - SQUARE_DECAY**self.steps
        for tensor, first, second, rate in zip(tensors, self.first, self.second, rates, strict=True):
            assert tensor.grad is not None
            first.lerp_(tensor.grad, 1 - DECAY)
            second.mul_(SQUARE_DECAY).addcmul_(tensor.grad, tensor.grad, value=1 - SQUARE_DECAY)
            move = first / second.div(second_scale).sqrt_().add_(SMALL)
            tensor -= move.mul_(rate).div_(first_scale)

    def select(self, sources: Int[Tensor, " M"], fresh: Tensor) -> RowAdam:
        """The moments of the rows `sources`, zero where `fresh`."""
        moments = [[tensor[sources] for tensor in group] for group in (self.first, self.second)]
        for group in moments:
            for tensor in group:
                tensor[fresh] = 0.0
        return RowAdam(moments[0], moments[1], self.steps)
