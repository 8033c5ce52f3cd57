"""Observations: rims of masks, cropping, sizes; similarity of images."""

import numpy as np
import pytest
import torch
from scipy.ndimage import binary_dilation, correlate1d

from physconvex import InputError
from physconvex.reconstruction import observation_of, psnr, structural_similarity
from tests.reconstruction.scenes import pictures, ring


def test_an_image_with_alpha_is_put_before_white():
    camera = ring(1)[0]
    frame, alpha = pictures(camera)
    seen = observation_of(camera, frame, alpha)
    half = alpha.astype(np.float32)[..., None] / 255
    np.testing.assert_allclose(seen.image, half * frame / 255 + 1 - half, atol=1e-6)
    assert torch.equal(seen.background, torch.ones_like(seen.image))


def test_behind_a_binary_mask_the_background_is_continued():
    camera = ring(1)[0]
    frame, alpha = pictures(camera)
    wall = np.broadcast_to(np.linspace(100, 200, 48).astype(np.uint8)[:, None, None], (48, 48, 3))
    share = alpha[..., None] / 255
    mixed = (share * frame + (1 - share) * wall).round().astype(np.uint8)
    seen = observation_of(camera, mixed, alpha > 127)
    outside = binary_dilation(alpha > 0, iterations=5) == 0
    np.testing.assert_allclose(seen.image, mixed / np.float32(255), atol=1e-6)
    np.testing.assert_allclose(seen.background[outside], wall[outside] / 255, atol=1e-6)
    rim = binary_dilation(alpha > 0, iterations=2) & (alpha < 255)
    np.testing.assert_allclose(seen.background[rim], wall[rim] / 255, atol=0.06)  # a wall unlike the ball
    assert set(np.unique(seen.coverage)) == {0.0, 1.0}


def test_cropping_and_resizing_keep_where_points_are_seen():
    seen = observation_of(ring(1)[0], *pictures(ring(1)[0]))
    part = seen.cropped()
    assert part.image.shape[0] < 48 and part.coverage.sum() == seen.coverage.sum()
    point = np.array([0.01, 0.02, 0.03])
    old, new, small = (one.camera.project(point)[0] for one in (seen, part, seen.resized(0.5)))
    shift = (old - new).round().astype(int)
    np.testing.assert_allclose(old - new, shift, atol=1e-9)
    np.testing.assert_allclose(small, old / 2)
    column, row = shift
    height, width = part.coverage.shape
    assert torch.equal(part.image, seen.image[row : row + height, column : column + width])


@pytest.mark.wrong_types
def test_what_does_not_fit_is_refused():
    camera = ring(1)[0]
    frame, alpha = pictures(camera)
    with pytest.raises(InputError, match="expected 48×48"):
        observation_of(camera, frame[:-1], alpha)
    with pytest.raises(InputError, match="silhouette is empty"):
        observation_of(camera, frame, np.zeros_like(alpha))


def test_structural_similarity_is_that_of_the_paper():
    rng = np.random.default_rng(0)
    first, second = rng.random((2, 30, 26, 3))
    line = np.exp(-((np.arange(11) - 5) ** 2) / (2 * 1.5**2))

    def blur(values: np.ndarray) -> np.ndarray:
        for axis in (0, 1):
            values = correlate1d(values, line / line.sum(), axis=axis, mode="constant")
        return values

    means = blur(first), blur(second)
    variances = blur(first**2) - means[0] ** 2, blur(second**2) - means[1] ** 2
    covariance = blur(first * second) - means[0] * means[1]
    luminance = (2 * means[0] * means[1] + 1e-4) / (means[0] ** 2 + means[1] ** 2 + 1e-4)
    expected = luminance * (2 * covariance + 9e-4) / (sum(variances) + 9e-4)
    found = structural_similarity(torch.as_tensor(first), torch.as_tensor(second))
    assert float(found) == pytest.approx(expected.mean(), abs=1e-12)
    assert float(structural_similarity(*[torch.as_tensor(first)] * 2)) == pytest.approx(1.0)


def test_a_hundredth_of_difference_is_forty_decibels():
    image = torch.rand(5, 5, 3, generator=torch.Generator().manual_seed(0))
    assert psnr(image + 0.01, image) == pytest.approx(40.0, abs=1e-3)
