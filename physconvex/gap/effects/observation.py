"""Effects of the observation: cameras, markers, clocks, and the light of pictures.

Those of cameras, markers and clocks act on simulated positions before the comparison. An error of a camera becomes an
equivalent motion of the points: the stated camera sees x' = A(x) exactly where the true camera sees x. Effects of image
formation act on patches of pictures, and move no point.
"""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
from jaxtyping import Float

from physconvex.gap.effects.effect import Dose, Effect, Patches, Situation
from physconvex.gap.effects.motion import PointMotion
from physconvex.gap.effects.world import rotation_vector_matrix

Doses = Float[np.ndarray, " D"]
Positions = Float[np.ndarray, "T P 3"]


TIME_OFFSET = Effect(
    "time_offset",
    "observation",
    (Dose("offset", "s", -0.2, 0.2, 5e-4, lambda s: 0.1 / s.fps, plausible=0.05),),
    observe=lambda motion, doses: motion.at(motion.times + doses[0]),
    ahead=lambda end, doses: float(doses[0]),
    description="the recording starts later (or earlier) than the motion",
    confusable=("initial_velocity",),
)
TIME_SCALE = Effect(
    "time_scale",
    "observation",
    (Dose("relative_error", "", -0.5, 0.5, 2e-3, lambda s: 0.01, plausible=0.05),),
    observe=lambda motion, doses: motion.at(motion.times * (1 + doses[0])),
    ahead=lambda end, doses: end * float(doses[0]),
    description="the stated frame rate is wrong; within one flight the same as another gravity or size",
    confusable=("air_drag", "focal_length"),
)


def _moved(motion: PointMotion, doses: Doses) -> Positions:
    pivot = motion.rest.mean(0) if motion.camera is None else motion.camera.position
    turn = rotation_vector_matrix(np.radians(doses[:3]))
    return np.asarray((motion.positions - pivot) @ turn.T + pivot + doses[3:])


CAMERA_POSE = Effect(
    "camera_pose",
    "observation",
    tuple(Dose(f"turn_{axis}", "deg", -20.0, 20.0, 0.05, lambda s: 0.5) for axis in "xyz")
    + tuple(Dose(f"shift_{axis}", "m", -2.0, 2.0, 5e-4, lambda s: 0.01 * s.size) for axis in "xyz"),
    observe=_moved,
    applies=lambda situation: situation.starts_elsewhere,
    description="the frame of the camera, or of the marker system, is turned or shifted; seen at frame 0 already",
    confusable=("gravity_tilt",),
)


def _zoomed(motion: PointMotion, doses: Doses) -> Positions:
    camera = motion.camera
    assert camera is not None
    return camera.world(camera.local(motion.positions) * np.array([1 + doses[0], 1 + doses[0], 1.0]))


def _seen_by_camera(situation: Situation) -> bool:
    return situation.camera is not None


FOCAL_LENGTH = Effect(
    "focal_length",
    "observation",
    (Dose("relative_error", "", -0.5, 0.5, 2e-3, lambda s: 0.01),),
    observe=_zoomed,
    applies=_seen_by_camera,
    description="the camera's focal length is wrong: everything is seen too large or too small",
    confusable=("time_scale", "camera_pose"),
)


def _bent(motion: PointMotion, doses: Doses) -> Positions:
    camera = motion.camera
    assert camera is not None
    local = camera.local(motion.positions)
    square = (local[..., :2] ** 2).sum(-1, keepdims=True) / local[..., 2:] ** 2
    factors = np.concatenate([np.repeat(1 + doses[0] * square, 2, -1), np.ones_like(square)], -1)
    return camera.world(local * factors)


LENS_DISTORTION = Effect(
    "lens_distortion",
    "observation",
    (Dose("k1", "", -0.5, 0.5, 0.01, lambda s: 0.05),),
    observe=_bent,
    applies=_seen_by_camera,
    description="the lens bends straight lines",
    confusable=("focal_length",),
)


def _rolled(motion: PointMotion, doses: Doses) -> Positions:
    camera = motion.camera
    assert camera is not None
    pixels, _ = camera.project(motion.positions.reshape(-1, 3))
    rows = np.nan_to_num(pixels[:, 1], nan=0.5 * camera.h).reshape(motion.positions.shape[:2]) / camera.h
    return motion.at(motion.times[:, None] + doses[0] * (rows - 0.5))


ROLLING_SHUTTER = Effect(
    "rolling_shutter",
    "observation",
    (Dose("read_out_time", "s", -0.1, 0.1, 1e-3, lambda s: 0.2 / s.fps),),
    observe=_rolled,
    ahead=lambda end, doses: 0.5 * abs(float(doses[0])),
    applies=_seen_by_camera,
    description="rows of the image are exposed one after the other",
    confusable=("initial_spin", "time_offset"),
)
OBSERVATION_EFFECTS = (TIME_OFFSET, TIME_SCALE, CAMERA_POSE, FOCAL_LENGTH, LENS_DISTORTION, ROLLING_SHUTTER)


def _line(displacement: Float[np.ndarray, " 2"]) -> np.ndarray:
    """Kernel that averages along a centred straight line [pixels], by bilinear samples."""
    reach = int(np.ceil(np.abs(displacement).max() / 2)) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    count = 4 * int(np.ceil(np.linalg.norm(displacement))) + 1
    places = reach + np.linspace(-0.5, 0.5, count)[:, None] * displacement[::-1]  # rows, columns
    corner = np.floor(places).astype(int)
    part = places - corner
    for beyond in product((0, 1), repeat=2):
        np.add.at(kernel, tuple((corner + beyond).T), np.abs(1 - np.array(beyond) - part).prod(1))
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
    photograph=lambda patches, doses: patches.light * np.exp(doses[0] * patches.times)[:, None, None],
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
IMAGE_EFFECTS = (EXPOSURE, MOTION_BLUR)
