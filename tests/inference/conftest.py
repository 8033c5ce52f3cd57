"""Small mp4 files of a falling ball."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

MakeClip = Callable[..., Path]


def falling_ball(
    *, frames: int = 12, width: int = 64, height: int = 64, colour: tuple[int, int, int] = (40, 90, 200)
) -> np.ndarray:
    """Ball of radius height/8 that bounces before a still, grainy background, uint8 [T, H, W, 3]."""
    rng = np.random.default_rng(3)
    background = rng.integers(150, 170, (height, width, 3), dtype=np.uint8)
    y, x = np.mgrid[:height, :width]
    radius, floor = height / 8, height * 0.85
    images = []
    for k in range(frames):
        t = k / 24.0
        centre = height * 0.25 + abs(((t * 2.2) % 1.0) ** 2) * (floor - radius - height * 0.25)
        inside = (x - width / 2) ** 2 + (y - centre) ** 2 < radius**2
        images.append(np.where(inside[..., None], np.array(colour, np.uint8), background))
    return np.stack(images)


@pytest.fixture
def make_clip() -> MakeClip:
    """Write a falling ball to a path; options as of `falling_ball`, and fps."""

    from physconvex.io import write_video  # not above: `--typecheck` hooks the packages' first import

    def make(path: Path, *, fps: float = 24.0, **options: object) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_video(path, falling_ball(**options), fps=float(fps), preset="ultrafast")
        return path

    return make


@pytest.fixture
def ball() -> np.ndarray:
    """Frames of a falling ball, uint8 [12, 64, 64, 3]."""
    return falling_ball()
