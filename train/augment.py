"""Changes of a prepared clip that preserve its dimensionless stiffness and ν."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64, UInt8
from torchvision.transforms.v2 import functional as transforms

from models import GREY, MOMENT_NAMES, mirrored_moments
from train.config import AugmentConfig
from train.motion_states import flipped_states, referred_states

COLUMN = {name: k for k, name in enumerate(MOMENT_NAMES)}


@dataclass(frozen=True, eq=False)
class Sample:
    """One clip as arrays, with the rest points and the states, which rotate with it."""

    windows: UInt8[np.ndarray, "T W W 4"]
    moments: Float32[np.ndarray, "T M"]
    valid: Bool[np.ndarray, " T"]
    interval: float
    points: Float32[np.ndarray, "Q 3"]
    states: Float32[np.ndarray, "T S"]


def augment(sample: Sample, config: AugmentConfig, generator: np.random.Generator) -> Sample:
    """All changes, drawn from the generator alone."""
    sample = reindexed(sample, *_time_window(sample.valid, config, generator))
    if generator.random() < config.flip_share:
        sample = flipped(sample)
    noise = generator.normal(0, config.moment_noise, sample.moments.shape).astype(np.float32)
    noise[:, COLUMN["sxx"] : COLUMN["syy"] + 1] *= 0.2
    noise[:, COLUMN["touches_border"]] = 0
    sample = replace(sample, moments=sample.moments + noise * np.float32(generator.random()))
    return replace(sample, windows=_colours(_geometry(sample.windows, config, generator), config, generator))


def flipped(sample: Sample) -> Sample:
    """The mirror image."""
    moments, points = mirrored_moments(sample.moments), sample.points * np.array([-1, 1, 1], np.float32)
    windows, states = np.ascontiguousarray(sample.windows[:, :, ::-1]), flipped_states(sample.states)
    return replace(sample, windows=windows, moments=moments, points=points, states=states)


def _time_window(
    valid: Bool[np.ndarray, " T"], config: AugmentConfig, generator: np.random.Generator
) -> tuple[int, int, int]:
    """First frame, one beyond the last, and stride."""
    stop = int(valid.sum())
    start = int(generator.integers(min(config.latest_start, max(stop - 8, 0)) + 1))
    if generator.random() < config.shorten_share:
        stop -= int(generator.integers(1 + (stop - start) // 3))
    stride = 2 if generator.random() < config.stride_share and stop - start >= 16 else 1
    return start, stop, stride


def reindexed(sample: Sample, start: int, stop: int, stride: int) -> Sample:
    """As if filmed from frame `start` to before `stop`, every `stride`-th frame; the last is repeated.

    The moments refer to the first frames (`models.silhouette`), so they are moved and scaled.
    """
    chosen = np.arange(start, stop, stride)
    total = len(sample.valid)
    index: Int64[np.ndarray, " T"] = np.pad(chosen, (0, total - len(chosen)), mode="edge")
    return replace(
        sample,
        windows=sample.windows[index],
        moments=_referred_to_first(sample.moments[index]),
        states=referred_states(sample.states[index]),
        valid=np.arange(total) < len(chosen),
        interval=sample.interval * stride,
    )


def _referred_to_first(moments: Float32[np.ndarray, "T M"]) -> Float32[np.ndarray, "T M"]:
    result = moments.copy()
    for axis, names in (("centroid_x", ("left", "right")), ("centroid_y", ("bottom", "top"))):
        for name in (axis, *names):
            result[:, COLUMN[name]] -= moments[0, COLUMN[axis]]
    width = moments[:3, COLUMN["right"]] - moments[:3, COLUMN["left"]]
    height = moments[:3, COLUMN["top"]] - moments[:3, COLUMN["bottom"]]
    unit = max(float(np.median(np.maximum(width, height))), 0.05)
    result[:, : COLUMN["sxx"]] /= unit
    result[:, COLUMN["sxx"] : COLUMN["syy"] + 1] /= unit**2
    return result


def _geometry(
    windows: UInt8[np.ndarray, "T W W 4"], config: AugmentConfig, generator: np.random.Generator
) -> UInt8[np.ndarray, "T W W 4"]:
    """One zoom and shift for the whole clip; the coverage a pixel larger or smaller now and then."""
    size = windows.shape[1]
    zoom = float(np.exp(generator.uniform(-config.zoom, config.zoom)))
    move = generator.uniform(-config.shift, config.shift, 2) * size + (1 - zoom) * size / 2
    matrix = np.array([[zoom, 0, move[0]], [0, zoom, move[1]]], dtype=np.float32)
    erosion = generator.integers(2) if generator.random() < config.mask_share else None
    moved = np.empty_like(windows)
    for k, window in enumerate(windows):
        moved[k] = cv2.warpAffine(window, matrix, (size, size), borderValue=(GREY, GREY, GREY, 0))
        if erosion is not None:
            moved[k, ..., 3] = (cv2.erode, cv2.dilate)[erosion](moved[k, ..., 3], np.ones((3, 3), np.uint8))
    return moved


def _colours(
    windows: UInt8[np.ndarray, "T W W 4"], config: AugmentConfig, generator: np.random.Generator
) -> UInt8[np.ndarray, "T W W 4"]:
    """One change of colour for the whole clip; what is not the object stays mid-grey."""
    clip = torch.from_numpy(windows[..., :3]).movedim(-1, 1)
    factors = 1 + generator.uniform(-config.colour, config.colour, 3)
    clip = transforms.adjust_brightness(clip, float(factors[0]))
    clip = transforms.adjust_contrast(clip, float(factors[1]))
    if generator.random() < config.grey_share:
        clip = transforms.rgb_to_grayscale(clip, num_output_channels=3)
    else:
        clip = transforms.adjust_saturation(clip, float(factors[2]))
    cover = windows[..., 3:]
    return np.concatenate([np.where(cover > 0, clip.movedim(1, -1).numpy(), np.uint8(GREY)), cover], axis=3)
