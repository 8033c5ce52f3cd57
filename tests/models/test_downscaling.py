"""Pictures made smaller."""

import cv2
import numpy as np
import pytest

from models.downscaling import halvings, shrink


@pytest.mark.parametrize(
    ("edge", "target", "expected"), [(448, 128, 1), (512, 128, 2), (128, 128, 0), (100, 128, 0), (1920, 112, 4)]
)
def test_halvings_leave_enough(edge: int, target: int, expected: int) -> None:
    assert halvings(edge, target) == expected
    assert edge < target or edge / 2**expected >= target


@pytest.mark.parametrize("shape", [(448, 448, 3), (270, 480), (451, 447, 3), (1080, 1920, 3)])
def test_shrunk_pictures_are_area_averages(shape: tuple[int, ...]) -> None:
    """Two averages, one after the other, weigh pixels on the borders of cells a little differently than one does."""
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.integers(0, 256, shape).astype(np.uint8), (0, 0), 8.0)
    size = (112, 112 * shape[0] // shape[1])
    result = shrink(picture, size).astype(int)
    whole = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(int)
    assert result.shape == whole.shape
    assert np.abs(result - whole).max() <= 2
    assert abs(result.mean() - picture.mean()) < 0.5


def test_whole_factors_are_exact() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (64, 32), dtype=np.uint8)
    blocks = picture.reshape(16, 4, 8, 4).mean(axis=(1, 3))
    assert np.abs(shrink(picture, (8, 16)) - blocks).max() <= 0.5
