"""A small convolutional network on single frames: the shape of the object, independent of its position."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

_CONVOLUTIONS = ((8, 4, 2), (3, 2, 1), (3, 1, 1))  # kernel, stride, padding; the last one for all that follow


class FrameNetwork(nn.Module):
    """Windows that follow the object -> one vector per frame, from that frame and the first one.

    Convolutions of stride 4, 2, then 1; the last map is read whole, not averaged, since the position of the outline
    matters.
    """

    def __init__(self, channels: int, *, widths: tuple[int, ...], window: int) -> None:
        super().__init__()
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

    def forward(self, pictures: Float[Tensor, "B T 4 W W"]) -> Float[Tensor, "B T C"]:
        """The vectors, of pictures as `models.encoder.normalised` gives them."""
        maps = functional.gelu(self.reduce(self.layers(pictures.flatten(0, 1))))
        vectors = self.read(maps.flatten(1)).unflatten(0, pictures.shape[:2])
        return vectors + self.compare(vectors[:, :1])
