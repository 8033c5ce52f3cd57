"""Clips with true masks for the segmenter: read once, then cropped, recoloured and thinned again for every step."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Self, TypeVar

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int64, UInt8

from models import moving_window, stabilise
from train.records import LabelledClip


@dataclass(frozen=True)
class MaskedClip:
    """Frames of a fixed camera, and the object's masks."""

    frames: UInt8[np.ndarray, "T H W 3"]
    mask: Bool[np.ndarray, "T H W"]

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> Self:
        """All its arrays changed alike."""
        return replace(self, **{name: change(value) for name, value in vars(self).items()})


Clip = TypeVar("Clip", bound=MaskedClip)


@dataclass(frozen=True, kw_only=True)
class SegmentationAugmentation:
    """How far training clips may be changed."""

    lengths: tuple[int, ...] = (6, 8, 8, 10, 12, 16)
    """Frames shown."""
    resting: float = 0.4
    """Share of clips in which the object stops at some frame."""
    backwards: float = 0.2
    """Share of clips that are shown backwards."""
    zoom: tuple[float, float] = (0.6, 1.4)
    largest_side: int = 128  # [px]
    recoloured: float = 0.8
    """Share of clips whose colours are mixed anew."""
    apart: float = 0.5
    """Share of these in which object and background are recoloured apart."""
    noise: float = 6.0  # largest standard deviation, of 255


def read_masked_clips(
    clips: Iterable[LabelledClip], *, progress: Callable[[int], None] | None = None
) -> list[MaskedClip]:
    """Frames without shake and the true masks that move with them; calls `progress` with the number read."""
    out = []
    for clip in clips:
        steady = stabilise(clip.record.frames())
        out.append(MaskedClip(steady.frames, steady.follow(clip.record.mask())))
        if progress is not None:
            progress(len(out))
    return out


def moving_part(clip: MaskedClip, *, margin: int = 8) -> MaskedClip:
    """The part of the picture that moves; all of it if that is undetermined."""
    window = moving_window(clip.frames, margin=margin)
    return clip if window is None else clip.each(lambda array: array[:, *window])


def augmented(clip: MaskedClip, options: SegmentationAugmentation, generator: np.random.Generator) -> MaskedClip:
    """Fewer frames, perhaps mirrored, with other colours and size, and noise."""
    clip = rearranged(clip, options, generator)
    clip = resized(moving_part(clip, margin=int(generator.integers(4, 17))), options, generator)
    return recoloured(clip, options, generator)


def rearranged(clip: Clip, options: SegmentationAugmentation, generator: np.random.Generator) -> Clip:
    """Fewer frames, so that less of the background is uncovered; perhaps mirrored."""
    order = frame_order(len(clip.frames), options, generator)
    flip = -1 if generator.random() < 0.5 else 1
    return clip.each(lambda array: np.ascontiguousarray(array[order, :, ::flip]))


def recoloured(clip: Clip, options: SegmentationAugmentation, generator: np.random.Generator) -> Clip:
    """The clip in other colours, or its own, with noise."""
    frames = clip.frames.astype(np.float32)
    if generator.random() < options.recoloured:
        frames = _recoloured(frames, clip.mask, generator, apart=generator.random() < options.apart)
    sigma = options.noise * generator.random() ** 2
    frames += np.float32(sigma) * generator.standard_normal(frames.shape, dtype=np.float32)
    return replace(clip, frames=np.clip(frames + 0.5, 0, 255).astype(np.uint8))


def frame_order(
    total: int, options: SegmentationAugmentation, generator: np.random.Generator
) -> Int64[np.ndarray, " T"]:
    """Which frames of a clip are shown: fewer, at times every other, at times resting at the end or backwards."""
    count = min(int(generator.choice(options.lengths)), total)
    stride = 2 if generator.random() < 0.4 and 2 * count <= total else 1
    start = int(generator.integers(0, total - stride * (count - 1)))
    order = start + stride * np.arange(count)
    if generator.random() < options.resting:
        order = np.minimum(order, order[generator.integers(1, count)])
    if generator.random() < options.backwards:
        order = order[::-1]
    return order


def resized(clip: Clip, options: SegmentationAugmentation, generator: np.random.Generator) -> Clip:
    """Of another size, at most `options.largest_side`; often of the old one. Masks are cut at one half."""
    height, width = clip.mask.shape[1:]
    scale = min(float(np.exp(generator.uniform(*np.log(options.zoom)))), options.largest_side / max(height, width))
    size = (max(16, round(width * scale)), max(16, round(height * scale)))
    if generator.random() < 0.3 or size == (width, height):
        return clip
    method = cv2.INTER_AREA if size[0] < width else cv2.INTER_LINEAR

    def scaled(array: np.ndarray) -> np.ndarray:
        if array.dtype == bool:
            return scaled(array * np.uint8(255)) > 127
        return np.stack([cv2.resize(frame, size, interpolation=method) for frame in array])

    return clip.each(scaled)


def _recoloured(
    frames: Float32[np.ndarray, "T H W 3"],
    mask: Bool[np.ndarray, "T H W"],
    generator: np.random.Generator,
    *,
    apart: bool,
) -> Float32[np.ndarray, "T H W 3"]:
    mixed = _mixed(frames, generator)
    if not apart:
        return mixed
    cover = np.stack([cv2.blur(m * np.uint8(255), (2, 2)) for m in mask]).astype(np.float32)[..., None] / 255
    return mixed * (1 - cover) + _mixed(frames, generator) * cover


def _mixed(frames: Float32[np.ndarray, "T H W 3"], generator: np.random.Generator) -> Float32[np.ndarray, "T H W 3"]:
    """Channels mixed, contrast and brightness changed, at times as a negative."""
    matrix = 0.25 * generator.standard_normal((3, 3)) + np.eye(3)[generator.permutation(3)]
    matrix *= generator.uniform(0.5, 1.3) / np.maximum(np.abs(matrix.sum(axis=1, keepdims=True)), 0.5)
    if generator.random() < 0.2:
        matrix = -matrix
    middle = frames[:, ::4, ::4].mean(axis=(0, 1, 2))
    wanted = np.clip(middle + generator.uniform(-50, 50), 60, 195)
    affine = np.concatenate([matrix, (wanted - matrix @ middle)[:, None]], axis=1).astype(np.float32)
    rows = frames.reshape(1, -1, 3)
    return cv2.transform(rows, affine).reshape(frames.shape)
