"""Remove slight camera shake and exposure changes from a clip."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

_LEAST_SHIFT = 0.08  # [px]; smaller ones are noise of the estimate
_LARGEST_SHIFT = 4.0  # [px]


@dataclass(frozen=True)
class Stabilised:
    """Frames moved by `-shifts` [px; x, y] so that their background is aligned with the first frame."""

    frames: UInt8[np.ndarray, "T H W 3"]
    shifts: Float64[np.ndarray, "T 2"]

    def undo(self, coverage: UInt8[np.ndarray, "T H W"]) -> UInt8[np.ndarray, "T H W"]:
        """Move coverage (0..255) of the stabilised frames to its position in the original frames.

        Moved coverage becomes 0 or 255.
        """
        return _moved(coverage, self.shifts) * np.uint8(255) if self.shifts.any() else coverage

    def follow(self, masks: Bool[np.ndarray, "T H W"]) -> Bool[np.ndarray, "T H W"]:
        """Move masks of the original frames to their position in the stabilised frames."""
        return _moved(masks * np.uint8(255), -self.shifts) if self.shifts.any() else masks


def _moved(coverage: UInt8[np.ndarray, "T H W"], shifts: Float64[np.ndarray, "T 2"]) -> Bool[np.ndarray, "T H W"]:
    return np.stack([_translate(frame, shift) > 127 for frame, shift in zip(coverage, shifts, strict=True)])


def stabilise(frames: UInt8[np.ndarray, "T H W 3"]) -> Stabilised:
    """Undo gain and sub-pixel translation of each frame against the first.

    Translation by one robust Gauss-Newton step per pass (Lucas and Kanade 1981) on the brightness; pixels
    that differ much, such as the object's, are left out.
    """
    thin = frames[:, ::4, ::4].astype(np.float32) + 1.0
    gains = np.median((thin[0] / thin).reshape(len(frames), -1), axis=1)
    level = [
        frame if abs(gain - 1) < 0.004 else cv2.convertScaleAbs(frame, alpha=float(gain))
        for frame, gain in zip(frames, gains, strict=True)
    ]
    size = (max(8, frames.shape[2] // 2), max(8, frames.shape[1] // 2))
    grey = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in level]
    half = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in grey]
    small = [cv2.GaussianBlur(image, (3, 3), 0.8).astype(np.float32) for image in half]
    shifts = np.stack([_shift(small[0], image) for image in small]) * (frames.shape[2] / size[0])
    if np.abs(shifts).max() < _LEAST_SHIFT or np.abs(shifts).max() > _LARGEST_SHIFT:
        return Stabilised(frames=np.stack(level), shifts=np.zeros_like(shifts))
    still = [_translate(frame, -shift) for frame, shift in zip(level, shifts, strict=True)]
    return Stabilised(frames=np.stack(still), shifts=shifts)


def _shift(
    reference: Float32[np.ndarray, "H W"], image: Float32[np.ndarray, "H W"], *, passes: int = 2
) -> Float64[np.ndarray, " 2"]:
    """Translation (x, y) [px] of `image` against `reference`; zero if the picture does not determine it."""
    gx = cv2.Sobel(reference, cv2.CV_32F, 1, 0, scale=0.125)
    gy = cv2.Sobel(reference, cv2.CV_32F, 0, 1, scale=0.125)
    total = np.zeros(2)
    for _ in range(passes):
        error = reference - (_translate(image, -total) if total.any() else image)
        weight = np.abs(error) < max(3.0, 3.0 * float(np.median(np.abs(error[::4, ::4]))))
        wx, wy = gx * weight, gy * weight
        normal = np.array([[np.vdot(wx, gx), np.vdot(wx, gy)], [np.vdot(wx, gy), np.vdot(wy, gy)]], dtype=np.float64)
        normal += 2e-2 * error.size * np.eye(2)  # a uniform picture is not moved
        total += np.linalg.solve(normal, [np.vdot(wx, error), np.vdot(wy, error)])
    return total


def _translate(image: np.ndarray, shift: Float64[np.ndarray, " 2"]) -> np.ndarray:
    matrix = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], dtype=np.float64)
    size = (image.shape[1], image.shape[0])
    return cv2.warpAffine(image, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
