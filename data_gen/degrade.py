"""Degradations of real clips: noise, compression, motion blur, exposure, shake. Drawn per view and recorded."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from data_gen.config import DegradationConfig


@dataclass(frozen=True)
class Degradation:
    """Strengths of one view's degradations; zero (or one for `gain`, `gamma`) means absent.

    Attributes:
        noise: standard deviation of the sensor noise, relative to full scale.
        crf: x264 quality of the stored video.
        shutter: open share of the frame interval (motion blur).
        gain: factors on linear red, green, blue.
        gamma: exponent.
        shake: standard deviation of the camera's wander, in image heights.
    """

    noise: float
    crf: int
    shutter: float
    gain: tuple[float, float, float]
    gamma: float
    shake: float


def draw_degradation(config: DegradationConfig, rng: np.random.Generator, crf: int) -> Degradation:
    """Draw the degradations of one view; `crf` holds where no stronger compression is drawn."""
    noisy, compressed, blurred, exposed, shaken = rng.random(5) < (
        config.noise_share,
        config.compression_share,
        config.blur_share,
        config.exposure_share,
        config.shake_share,
    )
    ranges = (config.noise, config.compression_crf, config.shutter, config.exposure_stops, config.white_balance)
    noise, strong, shutter, stops, red = (values.sample(rng) for values in ranges)
    blue, gamma, wander = (values.sample(rng) for values in (config.white_balance, config.gamma, config.shake))
    gain = 2.0**stops
    return Degradation(
        noise=noise if noisy else 0.0,
        crf=round(strong) if compressed else crf,
        shutter=shutter if blurred else 0.0,
        gain=(gain * (1 + red), gain, gain * (1 + blue)) if exposed else (1.0, 1.0, 1.0),
        gamma=gamma if exposed else 1.0,
        shake=wander if shaken else 0.0,
    )


def sub_positions(positions: Float[np.ndarray, "T P 3"], shutter: float, count: int) -> Float[np.ndarray, "T S P 3"]:
    """Positions while the shutter is open, interpolated towards the next frame; S = 1 without blur."""
    if shutter == 0.0:
        return positions[:, None]
    ahead = np.concatenate([positions[1:], 2 * positions[-1:] - positions[-2:-1]])
    share = np.linspace(0.0, shutter, count)[None, :, None, None]
    return positions[:, None] * (1 - share) + ahead[:, None] * share


def expose(
    image: Float[np.ndarray, "h w 3"], degradation: Degradation, rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """Exposure, white balance, gamma and noise of one image (0..1), as bytes."""
    image = np.clip(image * np.asarray(degradation.gain, dtype=np.float32), 0, 1) ** degradation.gamma
    if degradation.noise > 0:
        image = image + rng.normal(scale=degradation.noise, size=image.shape)
    return np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)


def shake(
    images: UInt8[np.ndarray, "T h w ..."], degradation: Degradation, rng: np.random.Generator
) -> UInt8[np.ndarray, "T h w ..."]:
    """Images moved by a smooth random walk; equal generators move equally, so masks can follow."""
    if degradation.shake == 0.0:
        return images
    height, width = images.shape[1:3]
    steps = rng.normal(size=(len(images), 2))
    path = np.cumsum(steps, axis=0) - np.arange(len(images))[:, None] * steps.mean(axis=0)
    path *= degradation.shake * height / max(float(path.std()), 1e-9)
    moved = []
    for image, (dx, dy) in zip(images, path, strict=True):
        move = np.array([[1, 0, dx], [0, 1, dy]])
        moved.append(cv2.warpAffine(image, move, (width, height), borderMode=cv2.BORDER_REPLICATE))
    return np.stack(moved)
