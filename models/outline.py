"""The object's outline: a small convolutional network that corrects a rough silhouette.

It compares each frame with the background that the object uncovers in the others (the median over the frames in which
the rough silhouette is elsewhere), so that it can distinguish the object from its shadow. Further inputs are the
likelihood ratio of each pixel's colour, inside over around the rough silhouettes, and the mean features of both over
the clip. A U-Net (Ronneberger et al. 2015) over blocks of two by two pixels, like `models.segmenter`, whose silhouette
is its start.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int, UInt8
from torch import Tensor, nn
from torch.nn import functional

from models.appearance import LARGEST_RATIO, colour_codes, colour_ratio, sort_pictures
from models.checkpoint_files import BUNDLED, FinderConfig, load_finder_network

BUNDLED_OUTLINE = BUNDLED / "outline"

_BLOCK = 2  # pixels that enter together, along each edge
_MULTIPLE = 8  # of which padded pictures have edges: blocks of two, halved twice
_CHANNELS = 9  # frame, frame - background, background known, likelihood of the colour, rough log odds
_LARGEST_ODDS = 5.0
_POSSIBLE = 0.3  # coverage
_RIM = 5  # [px] edge of the square by which the possible region grows


class OutlineConfig(FinderConfig):
    """All of an outline network's checkpoint but its tensors."""

    format: Literal["physconvex/outline/1"] = "physconvex/outline/1"
    channels: tuple[int, int, int] = (16, 32, 48)
    """At a half, a quarter and an eighth of the resolution."""


@dataclass(frozen=True)
class UncoveredBackground:
    """The background behind the object, and the pixels at which at least two frames show it."""

    picture: UInt8[np.ndarray, "H W 3"]
    known: Bool[np.ndarray, "H W"]


class OutlineNetwork(nn.Module):
    """Logits of the object's coverage of each pixel."""

    def __init__(self, config: OutlineConfig | None = None) -> None:
        super().__init__()
        self.config = config or OutlineConfig()
        rim, middle, deep = self.config.channels
        self.stem = nn.Conv2d(_CHANNELS, rim, _BLOCK, stride=_BLOCK)
        self.first = _convolution(rim, rim)
        self.down = nn.ModuleList([_convolution(rim, middle, stride=2), _convolution(middle, deep, stride=2)])
        self.inner = nn.ModuleList([_convolution(middle, middle), _convolution(deep, deep)])
        self.context = nn.Linear(2 * deep, deep)
        self.last = _convolution(deep, deep)
        self.up = nn.ModuleList([nn.Conv2d(deep, middle, 1), nn.Conv2d(middle, rim, 1)])
        self.merge = nn.ModuleList([_convolution(middle, middle), _convolution(rim, rim)])
        self.out = nn.Conv2d(rim, _BLOCK**2, 1)

    def forward(self, planes: Float[Tensor, "T 9 H W"]) -> Float[Tensor, "T H W"]:
        """`outline_input` of the frames of one clip -> logits."""
        x = self.stem(planes).relu_()
        x = self.first(x).add_(x).relu_()
        skips = []
        for down, inner in zip(self.down, self.inner, strict=True):
            skips.append(x)
            x = down(x).relu_()
            x = inner(x).add_(x).relu_()
        x = (x + self._clip_context(x, planes)).relu_()
        x = self.last(x).add_(x).relu_()
        for up, merge in zip(self.up, self.merge, strict=True):
            x = functional.interpolate(up(x), scale_factor=2, mode="nearest").add_(skips.pop()).relu_()
            x = merge(x).add_(x).relu_()
        return functional.pixel_shuffle(self.out(x), _BLOCK)[:, 0]

    def _clip_context(self, x: Float[Tensor, "T C h w"], planes: Float[Tensor, "T 9 H W"]) -> Tensor:
        """Mean features over the clip inside and around the rough silhouette."""
        inside = functional.avg_pool2d(planes[:, -1:], _MULTIPLE).mul(_LARGEST_ODDS).sigmoid()
        pooled = [(x * w).sum(dim=(0, 2, 3)) / (w.sum() + 1e-3) for w in (inside, 1 - inside)]
        context: Tensor = self.context(torch.cat(pooled))[None, :, None, None]
        return context


def _convolution(inputs: int, outputs: int, *, stride: int = 1) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1)


def uncovered_background(
    frames: UInt8[np.ndarray, "T H W 3"], covered: Bool[np.ndarray, "T H W"]
) -> UncoveredBackground:
    """The background: per pixel and colour the median over the frames that do not show the object.

    Args:
        frames: of a fixed camera.
        covered: near or on the object.
    """
    count = (~covered).sum(axis=0)
    ordered = sort_pictures([np.where(c[..., None], np.uint8(255), f) for f, c in zip(frames, covered, strict=True)])
    middle = np.maximum(count - 1, 0) // 2
    median = np.take_along_axis(ordered, middle[None, ..., None], axis=0)[0]
    return UncoveredBackground(np.where(count[..., None] > 0, median, frames[0]), count >= 2)


def outline_input(
    frames: UInt8[np.ndarray, "T H W 3"],
    coverage: Float32[np.ndarray, "T H W"],
    *,
    shown: Int[np.ndarray, " N"] | None = None,
) -> Float32[Tensor, "N 9 h w"]:
    """Input of the network, edges padded to multiples of 8.

    Background and colours are those of the whole clip, the result that of the frames `shown` (all unless given).
    """
    background = uncovered_background(frames, near_object(coverage))
    inside = coverage > 0.5
    codes = colour_codes(frames)
    ratio = colour_ratio(codes, inside)
    if shown is not None:
        frames, coverage, codes = frames[shown], coverage[shown], codes[shown]
    height, width = frames.shape[1:3]
    planes = np.empty((len(frames), _CHANNELS, height + -height % _MULTIPLE, width + -width % _MULTIPLE), np.float32)
    inner = planes[..., :height, :width]
    inner[:, :3] = frames.transpose(0, 3, 1, 2)
    inner[:, 3:6] = inner[:, :3] - background.picture.transpose(2, 0, 1).astype(np.float32)
    inner[:, :3] -= 128
    inner[:, :6] *= 1 / 32
    inner[:, 6] = background.known
    inner[:, 7] = (ratio / LARGEST_RATIO)[codes]
    odds = np.log(coverage + 5e-3) - np.log(1.005 - coverage)
    inner[:, 8] = odds * (1 / _LARGEST_ODDS)
    planes[..., height:, :] = planes[..., height - 1 : height, :]
    planes[..., width:] = planes[..., width - 1 : width]
    return torch.from_numpy(planes)


def near_object(coverage: Float32[np.ndarray, "T H W"]) -> Bool[np.ndarray, "T H W"]:
    """Possible region of the object, for a rough coverage (0..1)."""
    kernel = np.ones((_RIM, _RIM), np.uint8)
    return np.stack([cv2.dilate((c > _POSSIBLE).astype(np.uint8), kernel) for c in coverage]) > 0


def refined_coverage(
    frames: UInt8[np.ndarray, "T H W 3"],
    coverage: Float32[np.ndarray, "T H W"],
    *,
    network: OutlineNetwork | None = None,
) -> Float32[np.ndarray, "T H W"]:
    """Probability of the object for each pixel of each frame (0..1), from a rough silhouette (0..1).

    The bundled network, read once per process, unless another is given.
    """
    corrected = network or _bundled()
    height, width = frames.shape[1:3]
    with torch.inference_mode():
        logits = corrected(outline_input(frames, coverage))
        refined: Float32[np.ndarray, "T H W"] = logits[:, :height, :width].sigmoid().numpy()
    return refined


def load_outline(folder: str | os.PathLike[str] = BUNDLED_OUTLINE) -> OutlineNetwork:
    """An outline network, the bundled one unless a folder is given, in float32 and evaluation mode.

    Raises:
        InputError: there is none, it is of another format, or its tensors do not fit its configuration.
    """
    return load_finder_network(folder, OutlineConfig, OutlineNetwork, name="outline")


_bundled = cache(load_outline)
