"""Effects of image formation: what a camera makes of light, not of places. They act on patches of its pictures."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float

from physconvex.gap.effects.effect import Dose, Effect, Patches, Situation

__all__ = ["EXPOSURE", "IMAGE_EFFECTS", "MOTION_BLUR"]


def _seen_by_camera(situation: Situation) -> bool:
    return situation.camera is not None


def _brighter(patches: Patches, doses: Float[np.ndarray, " D"]) -> Float[np.ndarray, "N h w"]:
    return np.asarray(patches.light * np.exp(doses[0] * patches.times)[:, None, None])


def _line(displacement: Float[np.ndarray, " 2"]) -> np.ndarray:
    """Kernel that averages over a straight way [pixels] with its middle at the middle: bilinear samples along it."""
    reach = int(np.ceil(np.abs(displacement).max() / 2)) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    count = 4 * int(np.ceil(np.linalg.norm(displacement))) + 1
    places = reach + np.linspace(-0.5, 0.5, count)[:, None] * displacement[::-1]  # rows, columns
    corner = np.floor(places).astype(int)
    part = places - corner
    for row in (0, 1):
        for column in (0, 1):
            weights = np.abs(1 - row - part[:, 0]) * np.abs(1 - column - part[:, 1])
            np.add.at(kernel, (corner[:, 0] + row, corner[:, 1] + column), weights)
    return kernel / count


def _smeared(patches: Patches, doses: Float[np.ndarray, " D"]) -> Float[np.ndarray, "N h w"]:
    if doses[0] <= 0:
        return patches.light
    smeared = [
        cv2.filter2D(light, -1, _line(velocity * doses[0]), borderType=cv2.BORDER_REPLICATE)
        for light, velocity in zip(patches.light, patches.velocities, strict=True)
    ]
    return np.array(smeared)


EXPOSURE = Effect(
    "exposure",
    "observation",
    (Dose("drift", "1/s", -5.0, 5.0, 0.05, lambda s: 1.0),),
    photograph=_brighter,
    applies=_seen_by_camera,
    description="the picture grows brighter or darker: logarithm of its light per second",
)
MOTION_BLUR = Effect(
    "motion_blur",
    "observation",
    (Dose("exposure_time", "s", 0.0, 0.2, 1e-3, lambda s: 0.5 / s.fps),),
    photograph=_smeared,
    applies=_seen_by_camera,
    description="the shutter stays open while the body moves: edges widen along the motion",
)
IMAGE_EFFECTS: tuple[Effect, ...] = (EXPOSURE, MOTION_BLUR)
