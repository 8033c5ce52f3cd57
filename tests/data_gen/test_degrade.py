"""Each degradation does what its strength says, and nothing when absent."""

import numpy as np
import pytest

from data_gen import draw_degradation, load_config
from data_gen.config import DegradationConfig
from data_gen.degrade import Degradation, expose, shake, sub_positions

NONE = Degradation(noise=0.0, crf=18, shutter=0.0, gain=(1.0, 1.0, 1.0), gamma=1.0, shake=0.0)


def degraded(**changes) -> Degradation:
    return Degradation(**(vars(NONE) | changes))


def test_nothing_changes_an_undegraded_clip():
    images = np.random.default_rng(0).integers(0, 256, (3, 8, 8, 3)).astype(np.uint8)
    rng = np.random.default_rng(1)
    exposed = np.stack([expose(image / np.float32(255), NONE, rng) for image in images])
    np.testing.assert_array_equal(exposed, images)
    assert shake(images, NONE, rng) is images


def test_noise_has_the_stated_strength():
    grey = np.full((200, 200, 3), 0.5, np.float32)
    noisy = expose(grey, degraded(noise=0.02), np.random.default_rng(0)) / 255
    # 120,000 samples: relative error of the standard deviation 0.2 %, rounding adds 1/(255·√12) in quadrature.
    assert noisy.std() == pytest.approx(np.hypot(0.02, 1 / 255 / np.sqrt(12)), rel=0.01)


def test_exposure_white_balance_and_gamma():
    grey = np.full((2, 2, 3), 0.25, np.float32)
    image = expose(grey, degraded(gain=(2.0, 1.0, 8.0), gamma=0.5), np.random.default_rng(0))
    expected = np.round(255 * np.minimum(0.25 * np.array([2, 1, 8]), 1) ** 0.5)
    np.testing.assert_array_equal(image[0, 0], expected)


def test_blur_interpolates_towards_the_next_frame():
    positions = np.zeros((3, 1, 3))
    positions[:, 0, 2] = [0.0, 1.0, 4.0]
    parts = sub_positions(positions, 0.5, 3)[:, :, 0, 2]
    np.testing.assert_allclose(parts, [[0, 0.25, 0.5], [1, 1.75, 2.5], [4, 4.75, 5.5]])
    assert sub_positions(positions, 0.0, 3).shape == (3, 1, 1, 3)


def test_shake_moves_pictures_and_masks_alike():
    rows, columns = np.mgrid[:64, :64]
    disc = np.where((rows - 32) ** 2 + (columns - 30) ** 2 < 100, 255, 0).astype(np.uint8)
    masks = np.repeat(disc[None], 24, axis=0)
    images = np.repeat(masks[..., None], 3, axis=-1)
    wobble = degraded(shake=0.02)
    moved = shake(images, wobble, np.random.default_rng(5))
    covered = shake(masks, wobble, np.random.default_rng(5))
    np.testing.assert_array_equal(moved[..., 0], covered)
    weight = covered / covered.sum(axis=(1, 2), keepdims=True)
    centre = np.stack([(weight * rows).sum(axis=(1, 2)), (weight * columns).sum(axis=(1, 2))])
    # Standard deviation over both axes: 0.02 of 64 pixels; bilinear resampling shifts no centroid.
    assert (centre - centre.mean(axis=1, keepdims=True)).std() == pytest.approx(0.02 * 64, rel=0.25)


def test_shares_and_strengths_are_those_of_the_configuration():
    config = DegradationConfig()
    drawn = [draw_degradation(config, np.random.default_rng(k), 18) for k in range(1000)]
    for values, share in (
        ([d.noise > 0 for d in drawn], 0.5),
        ([d.shutter > 0 for d in drawn], 0.3),
        ([d.shake > 0 for d in drawn], 0.25),
        ([d.gain != (1, 1, 1) for d in drawn], 0.5),
    ):
        # four standard deviations of a binomial share
        assert np.mean(values) == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / 1000))
    assert all(d.crf == 18 or 20 <= d.crf <= 33 for d in drawn)
    assert all(0.2 <= d.shutter <= 0.7 for d in drawn if d.shutter)


def test_the_clean_preset_degrades_nothing():
    config = load_config("clean").degradation
    assert all(draw_degradation(config, np.random.default_rng(k), 18) == NONE for k in range(50))
