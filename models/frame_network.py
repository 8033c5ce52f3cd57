"""A small convolutional network over single frames: the shape of the object, wherever it is."""

from __future__ import annotations

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn
from torch.nn import functional

__all__ = ["FrameNetwork", "object_windows"]

_FRAMES_FOR_UNIT = 3
_CONVOLUTIONS = ((8, 4, 2), (3, 2, 1), (3, 1, 1))  # kernel, stride, padding; the last one for all that follow


def object_windows(
    frames: UInt8[Tensor, "B T S S 3"], mask: UInt8[Tensor, "B T S S"], *, size: int, extent: float
) -> Float[Tensor, "B T 4 W W"]:
    """Square windows that follow the silhouette's centroid: RGB (-1..1, 0 = grey) and coverage (0..1).

    Args:
        frames: grey outside the object.
        mask: coverage 0..255.
        size: edge of the result [px].
        extent: edge of a window in units of the silhouette's larger edge, median over the first three frames.

    A frame without a silhouette is shown about the middle of the picture.
    """
    side = mask.shape[-1]
    cover = mask.float() / 255
    places = torch.arange(side, device=mask.device) + 0.5
    rows, columns = cover.sum(dim=3), cover.sum(dim=2)
    total = columns.sum(dim=-1)
    seen = total > 1.0
    centre = torch.stack([columns @ places, rows @ places], dim=-1) / total.clamp(min=1.0)[..., None]
    centre = torch.where(seen[..., None], centre, 0.5 * side)
    first = mask[:, :_FRAMES_FOR_UNIT] > 127
    unit = torch.maximum(first.any(dim=2).sum(dim=-1), first.any(dim=3).sum(dim=-1)).median(dim=1).values.clamp(min=4)
    offsets = ((torch.arange(size, device=mask.device) + 0.5) / size - 0.5) * extent * unit[:, None]
    place = (centre[..., None, :] + offsets[:, None, :, None]) * (2 / side) - 1  # [B, T, W, 2] of x and y, -1..1
    shape = (*mask.shape[:2], size, size)
    grid = torch.stack([place[..., 0][:, :, None].expand(shape), place[..., 1][..., None].expand(shape)], dim=-1)
    pictures = torch.cat([(frames.float() - 127.5) / 127.5, cover[..., None]], dim=-1).movedim(-1, 2)
    return functional.grid_sample(
        pictures.flatten(0, 1), grid.flatten(0, 1), mode="bilinear", padding_mode="zeros", align_corners=False
    ).unflatten(0, mask.shape[:2])


class FrameNetwork(nn.Module):
    """Frames and masks -> one vector per frame, from the window about the object and the first one's.

    Convolutions of stride 4, 2, then 1; the last map is read whole, not averaged, since where the outline runs matters.
    """

    def __init__(self, channels: int, *, widths: tuple[int, ...], window: int = 64, extent: float = 1.8) -> None:
        super().__init__()
        self.window, self.extent = window, extent
        layers: list[nn.Module] = []
        inputs, side = 4, window
        for number, width in enumerate(widths):
            size, stride, padding = _CONVOLUTIONS[min(number, len(_CONVOLUTIONS) - 1)]
            layers += [nn.Conv2d(inputs, width, size, stride, padding), nn.GroupNorm(8, width), nn.GELU()]
            inputs, side = width, (side + 2 * padding - size) // stride + 1
        self.layers = nn.Sequential(*layers)
        self.reduce = nn.Conv2d(inputs, 32, 1)
        self.read = nn.Linear(32 * side * side, channels)
        self.compare = nn.Linear(channels, channels)

    def forward(self, frames: UInt8[Tensor, "B T S S 3"], mask: UInt8[Tensor, "B T S S"]) -> Float[Tensor, "B T C"]:
        """The vectors."""
        windows = object_windows(frames, mask, size=self.window, extent=self.extent)
        maps = functional.gelu(self.reduce(self.layers(windows.flatten(0, 1))))
        vectors = self.read(maps.flatten(1)).unflatten(0, mask.shape[:2])
        return vectors + self.compare(vectors[:, :1])
