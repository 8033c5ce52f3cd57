"""The foreground on drawn clips: a textured ball falls, bounces and rests, its shadow moves with it."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from models import locate_foreground, sharp_foreground, stabilise
from physconvex import InputError


@dataclass(frozen=True)
class Drawing:
    """A clip to draw; lengths in image heights."""

    size: int = 96  # [px]
    frames: int = 24
    radius: float = 0.12
    start: float = 0.2
    floor: float = 0.85
    background: str = "gradient"  # or "texture"
    shadow: float = 0.5  # factor on the floor's brightness
    noise: float = 2.0  # standard deviation of 255
    shake: float = 0.0  # standard deviation [px]
    falls: bool = True


def _heights(drawing: Drawing) -> np.ndarray:
    """Centre of the ball in each frame: free fall, two bounces with restitution 0.5, then rest."""
    rest = drawing.floor - drawing.radius
    y, speed, path = drawing.start, 0.0, []
    for _ in range(drawing.frames):
        path.append(y)
        for _ in range(10):
            speed += 0.0008 if drawing.falls else 0.0
            y += speed
            if y > rest:
                y, speed = rest, -0.5 * speed if speed > 0.004 else 0.0
    return np.array(path)


def _backdrop(drawing: Drawing, generator: np.random.Generator) -> np.ndarray:
    size = drawing.size * 2
    rows = np.linspace(0, 1, size, dtype=np.float32)[:, None, None]
    image = np.broadcast_to((1 - rows) * [150, 190, 230] + rows * [90, 110, 140], (size, size, 3)).copy()
    if drawing.background == "texture":
        coarse = generator.uniform(-60, 60, (14, 14, 3)).astype(np.float32)
        image += cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC)
    image[int(size * 0.6) :] = image[int(size * 0.6) :] * 0.5 + [60, 50, 30]
    return image.clip(0, 255).astype(np.float32)


def _draw(drawing: Drawing, *, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Frames [T, H, W, 3] and true masks [T, H, W], drawn at twice the size and averaged."""
    generator = np.random.default_rng(seed)
    size = drawing.size * 2
    backdrop = _backdrop(drawing, generator)
    ball = cv2.resize(generator.uniform(0, 255, (9, 9, 3)).astype(np.float32), (size, size))
    ball = 0.5 * ball + np.float32([110, 30, 20])
    frames, masks = [], []
    for y in _heights(drawing):
        shadow = np.zeros((size, size), np.float32)
        center = (size // 2, int(drawing.floor * size))
        radius = drawing.radius * size
        cv2.ellipse(shadow, center, (int(radius), int(0.3 * radius)), 0, 0, 360, 1.0, -1)
        shadow = cv2.GaussianBlur(shadow, (0, 0), 3)[..., None]
        mask = np.zeros((size, size), np.uint8)
        cv2.circle(mask, (size // 2, int(y * size)), int(radius), 255, -1, cv2.LINE_AA)
        cover = (mask / np.float32(255))[..., None]
        texture = np.roll(ball, int(y * size), axis=0)
        image = backdrop * (1 - (1 - drawing.shadow) * shadow) * (1 - cover) + texture * cover
        shift = np.float32([[1, 0, 0], [0, 1, 0]])
        shift[:, 2] = 2 * drawing.shake * generator.standard_normal(2)
        moved = [cv2.warpAffine(a, shift, (size, size), borderMode=cv2.BORDER_REPLICATE) for a in (image, mask)]
        small = [cv2.resize(a, (drawing.size, drawing.size), interpolation=cv2.INTER_AREA) for a in moved]
        frames.append((small[0] + drawing.noise * generator.standard_normal(small[0].shape)).clip(0, 255))
        masks.append(small[1])
    return np.stack(frames).astype(np.uint8), np.stack(masks)


def _overlap(mask: np.ndarray, truth: np.ndarray) -> float:
    """Mean intersection over union of the frames."""
    a, b = mask, truth > 127
    return float(np.mean((a & b).sum(axis=(1, 2)) / (a | b).sum(axis=(1, 2))))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "drawing",
    [
        Drawing(),
        Drawing(background="texture"),
        Drawing(radius=0.2, start=0.5),  # falls less than its own height
        Drawing(background="texture", shake=0.5),
        Drawing(noise=6.0),
        Drawing(frames=48),  # rests most of the time
    ],
    ids=["gradient", "texture", "low", "shake", "noise", "rests"],
)
def test_falling_ball_is_found(drawing: Drawing, seed: int) -> None:
    frames, truth = _draw(drawing, seed=seed)
    found = locate_foreground(frames)
    assert found.source == "background_model"
    assert found.mask.shape == truth.shape and found.mask.dtype == bool
    assert _overlap(found.mask, truth) > 0.9
    assert found.confidence > 0.8


@pytest.mark.parametrize("background", ["gradient", "texture"])
def test_a_sharp_silhouette_follows_edges_that_the_finder_is_too_coarse_for(background: str) -> None:
    frames, truth = _draw(Drawing(size=256, frames=8, background=background))
    found, coarse = sharp_foreground(frames), locate_foreground(frames)
    assert (found.source, found.confidence) == (coarse.source, coarse.confidence)
    assert _overlap(found.mask, truth) > 0.97 > _overlap(coarse.mask, truth)


def test_a_still_clip_has_no_sharp_silhouette_either() -> None:
    frames = np.repeat(np.random.default_rng(0).integers(0, 255, (1, 64, 64, 3), dtype=np.uint8), 4, axis=0)
    assert sharp_foreground(frames).confidence == 0.0


def test_shadow_is_no_object() -> None:
    drawing = Drawing(start=0.15)
    frames, truth = _draw(drawing)
    found = locate_foreground(frames).mask
    below = np.zeros(truth.shape, bool)
    below[:, int((drawing.floor + 0.02) * drawing.size) :] = True  # under the ball, in its shadow
    assert (found[below & (truth == 0)] > 0).mean() < 0.01


def test_large_and_oblong_frames_are_found_as_well() -> None:
    frames, truth = _draw(Drawing())
    wide = np.stack([cv2.resize(frame, (640, 360)) for frame in frames])
    expected = np.stack([cv2.resize(mask, (640, 360)) for mask in truth])
    found = locate_foreground(wide)
    assert _overlap(found.mask, expected) > 0.9


def test_mask_goes_before_alpha_goes_before_the_model() -> None:
    frames, truth = _draw(Drawing(frames=6))
    alpha = np.where(truth > 127, 200, 30).astype(np.uint8)
    by_alpha = locate_foreground(frames, alpha=alpha)
    np.testing.assert_array_equal(by_alpha.mask, truth > 127)
    assert (by_alpha.source, by_alpha.confidence) == ("alpha", 1.0)
    by_mask = locate_foreground(frames, alpha=alpha, mask=truth[:, ::-1] > 127)
    np.testing.assert_array_equal(by_mask.mask, truth[:, ::-1] > 127)
    assert by_mask.source == "mask"


def test_mask_of_another_size_is_refused() -> None:
    frames, truth = _draw(Drawing(frames=6))
    with pytest.raises(InputError, match=r"mask: got shape \(5, 96, 96\)"):
        locate_foreground(frames, mask=truth[:5])


def test_still_object_before_a_plain_background_is_found_with_less_confidence() -> None:
    frames, truth = _draw(replace(Drawing(shadow=1.0, start=0.4, radius=0.2), falls=False))
    plain = np.where(truth[..., None] > 0, frames, np.uint8(200))
    found = locate_foreground(plain)
    assert found.source == "background_model"
    assert _overlap(found.mask, truth) > 0.9
    assert found.confidence <= 0.6


def test_nothing_to_find_gives_the_whole_frame() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    found = locate_foreground(np.stack([noise] * 12))
    assert (found.source, found.confidence) == ("whole_frame", 0.0)
    assert found.mask.all()


def test_moving_camera_gives_the_whole_frame() -> None:
    generator = np.random.default_rng(0)
    world = cv2.resize(generator.integers(0, 255, (40, 40, 3), dtype=np.uint8), (320, 320))
    frames = np.stack([world[6 * k : 6 * k + 96, 8 * k : 8 * k + 96] for k in range(24)])
    assert locate_foreground(frames).source == "whole_frame"


def test_stabilise_measures_shake_and_gain() -> None:
    frames, _ = _draw(Drawing(background="texture", noise=0.0, falls=False, frames=2))
    image = frames[0]
    shift = np.array([0.6, -0.4])
    matrix = np.float64([[1, 0, shift[0]], [0, 1, shift[1]]])
    moved = cv2.warpAffine(image, matrix, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
    darker = cv2.convertScaleAbs(moved, alpha=0.9)
    steady = stabilise(np.stack([image, darker, image]))
    np.testing.assert_allclose(steady.shifts[1], shift, atol=0.08)
    np.testing.assert_allclose(steady.shifts[2], 0.0, atol=0.02)
    before = np.abs(image.astype(float) - darker).mean()
    assert np.abs(image.astype(float) - steady.frames[1]).mean() < 0.3 * before
    mask = np.zeros(image.shape[:2], np.uint8)
    mask[30:60, 30:60] = 255
    expected = np.zeros_like(mask)
    expected[30:60, 31:61] = 255  # moved by (0.6, -0.4), rounded
    assert (steady.undo(np.stack([mask] * 3))[1] != expected).sum() <= 4  # corners
    back = steady.follow(steady.undo(np.stack([mask] * 3)) > 127)
    assert (back[1] != (mask > 127)).sum() <= 4
