"""A small convolutional network over single frames: what is where, to a fraction of a pixel."""

from __future__ import annotations

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

__all__ = ["FrameNetwork"]


class FrameNetwork(nn.Module):
    """Frames and masks -> one vector per frame.

    A convolution of stride 4, then others of stride 2; the last map is read whole, not averaged, since position is
    what matters.
    """

    def __init__(self, image_size: int, channels: int, *, widths: tuple[int, ...] = (32, 48, 64)) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        inputs, side = 4, image_size
        for width in widths:
            size, stride, padding = (8, 4, 2) if inputs == 4 else (3, 2, 1)
            layers += [nn.Conv2d(inputs, width, size, stride, padding), nn.GroupNorm(8, width), nn.GELU()]
            inputs, side = width, (side + 2 * padding - size) // stride + 1
        self.layers = nn.Sequential(*layers)
        self.reduce = nn.Conv2d(inputs, 24, 1)
        self.read = nn.Linear(24 * side * side, channels)

    def forward(self, frames: UInt8[Tensor, "B T S S 3"], mask: UInt8[Tensor, "B T S S"]) -> Float[Tensor, "B T C"]:
        """The vectors."""
        pixels = torch.cat([frames, mask[..., None]], dim=-1).flatten(0, 1).movedim(-1, 1)
        maps = self.reduce(self.layers(pixels.float() / 127.5 - 1))
        return self.read(maps.flatten(1)).unflatten(0, frames.shape[:2])
