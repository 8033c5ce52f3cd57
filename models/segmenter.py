"""A small convolutional network that finds the moving object in each frame.

The same network reads every frame. Its first layer reads differences to pictures of the whole clip (median over time,
first and last frame) and to mid-grey, so that it detects differences from the background. Single frames cannot
distinguish the object at rest from background that it uncovers. Features pooled over time provide this information;
they are added at each level of a U-Net (Ronneberger et al. 2015, "U-Net: convolutional networks for biomedical image
segmentation"). Pixels are processed in blocks of two by two (Shi et al. 2016, "Real-time single image and video
super-resolution using an efficient sub-pixel convolutional neural network"), which makes it fast on a processor.
"""

from __future__ import annotations

import os
from functools import cache
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Float32, UInt8
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from models.appearance import sort_pictures
from models.checkpoint_files import BUNDLED, FinderConfig, load_finder_network

BUNDLED_SEGMENTER = BUNDLED / "segmenter"

_BLOCK = 2  # pixels that enter together, along each edge
_MULTIPLE = 16  # of which padded pictures have edges: blocks of two, halved three times
_REFERENCES = 3  # median, first, last


class SegmenterConfig(FinderConfig):
    """All of a segmenter's checkpoint but its tensors."""

    format: Literal["physconvex/segmenter/1"] = "physconvex/segmenter/1"
    difference_channels: int = Field(default=4, ge=1)
    """Per picture that frames are compared with."""
    channels: tuple[int, int, int] = (32, 48, 64)
    """At a quarter, an eighth and a sixteenth of the resolution."""
    rim_channels: int = Field(default=8, ge=1)
    """At half the resolution, where outlines are made."""


class SilhouetteSegmenter(nn.Module):
    """Logits of the object's coverage of each pixel of the frames of one clip."""

    def __init__(self, config: SegmenterConfig | None = None) -> None:
        super().__init__()
        self.config = config or SegmenterConfig()
        pixels, rim = 3 * _BLOCK**2, (_REFERENCES + 1) * self.config.difference_channels
        channels = self.config.channels
        self.stem = nn.Conv2d(pixels, rim, 1)
        self.down = nn.ModuleList(
            _convolution(a, b, stride=2) for a, b in zip((rim, *channels), channels, strict=False)
        )
        self.deep = nn.ModuleList(_convolution(c, c) for c in channels)
        self.context = nn.ModuleList(_ClipContext(c) for c in channels)
        self.up = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in zip((rim, *channels), channels, strict=False))
        self.merge = nn.ModuleList(_convolution(c, c) for c in channels[:-1])
        self.rim = _convolution(rim, self.config.rim_channels)
        self.out = nn.Conv2d(self.config.rim_channels, _BLOCK**2, 1)

    def forward(
        self, frames: Float[Tensor, "T 12 h w"], references: Float[Tensor, "3 12 h w"]
    ) -> Float[Tensor, "T H W"]:
        """Frames and references as `block_pixels` gives them; H = 2 h and W = 2 w, multiples of 16."""
        x = self._differences(frames, references).relu_()
        skips = [x]
        for down, deep, context in zip(self.down, self.deep, self.context, strict=True):
            x = down(x).relu_()
            x = deep(x).add_(x).relu_()
            x = (x + context(x)).relu_()
            skips.append(x)
        for up, merge, skip in zip(self.up[:0:-1], self.merge[::-1], skips[-2:0:-1], strict=True):
            x = functional.interpolate(up(x), scale_factor=2, mode="nearest").add_(skip).relu_()
            x = merge(x).add_(x).relu_()
        x = functional.interpolate(self.up[0](x), scale_factor=2, mode="nearest").add_(skips[0]).relu_()
        return functional.pixel_shuffle(self.out(self.rim(x).relu_()), _BLOCK)[:, 0]

    def _differences(self, frames: Tensor, references: Tensor) -> Tensor:
        """`stem` of frame - reference, by linearity: of the frame, less of the reference."""
        weights = self.stem.weight.split(self.config.difference_channels)
        known = [functional.conv2d(r[None], w) for r, w in zip(references, weights, strict=False)]
        return self.stem(frames).sub_(torch.cat([*known, torch.zeros_like(known[0])], dim=1))


class _ClipContext(nn.Module):
    """Features of a place pooled over all frames, for each of them."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.mix = _convolution(4 * channels, channels)
        self.out = _convolution(channels, channels)

    def forward(self, x: Float[Tensor, "T C h w"]) -> Float[Tensor, "1 C h w"]:
        pooled = torch.cat([x.mean(dim=0), x.amax(dim=0), x[0], x[-1]])
        out: Tensor = self.out(self.mix(pooled[None]).relu_())
        return out


def _convolution(inputs: int, outputs: int, *, stride: int = 1) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1)


def clip_references(frames: UInt8[np.ndarray, "T H W 3"]) -> UInt8[np.ndarray, "3 H W 3"]:
    """Median over time, first and last frame."""
    ordered = sort_pictures(list(frames))
    return np.stack([ordered[len(frames) // 2], frames[0], frames[-1]])


def pad_pictures(pictures: UInt8[np.ndarray, "N h w 3"]) -> UInt8[np.ndarray, "N H W 3"]:
    """Last rows and columns repeated until the edges are multiples of 16."""
    height, width = pictures.shape[1:3]
    return np.pad(pictures, ((0, 0), (0, -height % _MULTIPLE), (0, -width % _MULTIPLE), (0, 0)), mode="edge")


def block_pixels(pictures: UInt8[np.ndarray, "N H W 3"]) -> Float32[Tensor, "N 12 h w"]:
    """Pictures as the network's input: from -4 to 4, blocks of two by two pixels as channels (channels last).

    Edges are multiples of 16 (`pad_pictures`).
    """
    count, height, width = pictures.shape[:3]
    split = pictures.reshape(count, height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK, 3)
    blocks = split.transpose(0, 1, 3, 2, 4, 5).astype(np.float32)
    blocks -= 128
    blocks *= 1 / 32
    flat = blocks.reshape(count, height // _BLOCK, width // _BLOCK, -1)
    return torch.from_numpy(flat).permute(0, 3, 1, 2)


def object_coverage(
    frames: UInt8[np.ndarray, "T H W 3"], *, segmenter: SilhouetteSegmenter | None = None
) -> Float32[np.ndarray, "T H W"]:
    """Probability of the object for each pixel of each frame (0..1), for frames of a fixed camera.

    Args:
        frames: the part of the picture in which something moves; any size.
        segmenter: the bundled one unless given; that is read once per process.
    """
    network = segmenter or _bundled()
    height, width = frames.shape[1:3]
    padded = pad_pictures(frames)
    with torch.inference_mode():
        logits = network(block_pixels(padded), block_pixels(clip_references(padded)))
        coverage: Float32[np.ndarray, "T H W"] = logits.sigmoid()[:, :height, :width].numpy()
    return coverage


def load_segmenter(folder: str | os.PathLike[str] = BUNDLED_SEGMENTER) -> SilhouetteSegmenter:
    """A segmenter, the bundled one unless a folder is given, in float32 and evaluation mode.

    Raises:
        InputError: there is none, it is of another format, or its tensors do not fit its configuration.
    """
    return load_finder_network(folder, SegmenterConfig, SilhouetteSegmenter, name="segmenter")


_bundled = cache(load_segmenter)
