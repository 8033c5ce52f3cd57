"""Augmentation leaves the physics alone: what it does to moments is what it does to pictures."""

import numpy as np
import pytest

from models import STATE_NAMES, silhouette_moments
from train.augment import Sample, augment, flipped, reindexed
from train.config import AugmentConfig


@pytest.fixture
def sample() -> Sample:
    """A tilted ellipse that falls and turns."""
    rows, columns = np.mgrid[0:48, 0:48] + 0.5
    masks = []
    for t in range(12):
        angle, x, y = 0.4 + 0.05 * t, columns - 20 - 0.5 * t, rows - 12 - 1.5 * t
        along, across = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
        masks.append((255 * np.clip(4.5 - np.hypot(along / 2, across) + 0.5, 0, 1)).astype(np.uint8))
    mask = np.stack(masks)
    colours = np.where(mask[..., None] > 0, np.uint8([200, 90, 40]), np.uint8(127))
    windows = np.concatenate([colours, mask[..., None]], axis=3)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (7, 3)).astype(np.float32)
    states = np.zeros((12, len(STATE_NAMES)), np.float32)
    return Sample(windows, silhouette_moments(mask).moments, np.full(12, True), 0.13, points, states)


def test_flipped_moments_are_those_of_the_mirror_image(sample: Sample) -> None:
    mirrored = flipped(sample)
    np.testing.assert_allclose(mirrored.moments, silhouette_moments(mirrored.windows[..., 3]).moments, atol=1e-5)
    np.testing.assert_array_equal(mirrored.windows[:, :, 0], sample.windows[:, :, -1])
    np.testing.assert_array_equal(mirrored.points[:, 0], -sample.points[:, 0])
    again = flipped(mirrored)
    for name in ("windows", "moments", "points"):
        np.testing.assert_array_equal(getattr(again, name), getattr(sample, name))


@pytest.mark.parametrize(("start", "stop", "stride"), [(0, 12, 1), (3, 12, 1), (0, 8, 1), (2, 12, 2)])
def test_another_window_has_the_moments_of_its_frames(sample: Sample, start: int, stop: int, stride: int) -> None:
    shown = reindexed(sample, start, stop, stride)
    np.testing.assert_allclose(shown.moments, silhouette_moments(shown.windows[..., 3]).moments, atol=1e-5)
    assert shown.interval == sample.interval * stride
    assert int(shown.valid.sum()) == len(range(start, stop, stride))
    assert (shown.windows[shown.valid.sum() :] == shown.windows[shown.valid.sum() - 1]).all()


def test_all_of_it_is_a_function_of_the_generator(sample: Sample) -> None:
    config = AugmentConfig(stride_share=0.5, shorten_share=0.5, mask_share=0.5)
    first, same, other = (augment(sample, config, np.random.default_rng(seed)) for seed in (1, 1, 2))
    for name in ("windows", "moments", "points"):
        np.testing.assert_array_equal(getattr(first, name), getattr(same, name))
    assert not np.array_equal(first.windows, other.windows)
    assert first.windows.shape == sample.windows.shape and first.windows.dtype == np.uint8


def test_what_is_not_the_object_stays_grey(sample: Sample) -> None:
    changed = augment(sample, AugmentConfig(colour=0.5), np.random.default_rng(5))
    colours, cover = changed.windows[..., :3], changed.windows[..., 3]
    assert (colours[cover == 0] == 127).all()
    assert not (colours[cover == 255] == 127).all()


def test_no_share_no_change(sample: Sample) -> None:
    nothing = AugmentConfig(
        flip_share=0, latest_start=0, stride_share=0, shorten_share=0, zoom=0, shift=0, colour=0, grey_share=0,
        mask_share=0, moment_noise=0,
    )  # fmt: skip
    same = augment(sample, nothing, np.random.default_rng(0))
    np.testing.assert_array_equal(same.windows, sample.windows)
    np.testing.assert_allclose(same.moments, sample.moments, atol=1e-6)
