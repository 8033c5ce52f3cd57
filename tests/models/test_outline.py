from pathlib import Path

import cv2
import numpy as np
import pytest

from models import (
    OutlineConfig,
    OutlineNetwork,
    load_outline,
    moving_window,
    object_coverage,
    outline_input,
    refined_coverage,
    save_network,
)
from models.outline import BUNDLED_OUTLINE, near_object, uncovered_background
from physconvex import InputError

SMALL = OutlineConfig(channels=(4, 6, 8))


def _moving_disc(*, height: int = 96, width: int = 112, count: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """A textured disc that falls before a textured background, and its masks."""
    generator = np.random.default_rng(3)
    coarse = generator.uniform(40, 200, (12, 14, 3)).astype(np.float32)
    backdrop = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    pattern = cv2.resize(generator.uniform(0, 255, (10, 10, 3)).astype(np.float32), (width, height))
    frames, masks = [], []
    for k in range(count):
        mask = np.zeros((height, width), np.uint8)
        cv2.circle(mask, (width // 2, int(20 + 0.3 * k**2)), 14, 255, -1)
        image = np.where(mask[..., None] > 0, 0.6 * pattern, backdrop) + 2 * generator.standard_normal(backdrop.shape)
        frames.append(image.clip(0, 255).astype(np.uint8))
        masks.append(mask > 0)
    return np.stack(frames), np.stack(masks)


def _found(frames: np.ndarray) -> np.ndarray:
    window = moving_window(frames)
    assert window is not None
    found = np.zeros(frames.shape[:3], bool)
    part = np.ascontiguousarray(frames[:, *window])
    found[:, *window] = refined_coverage(part, object_coverage(part)) > 0.5
    return found


def _overlap(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.mean((found & truth).sum(axis=(1, 2)) / (found | truth).sum(axis=(1, 2))))


def test_refined_coverage_is_that_of_a_moving_disc_before_a_texture() -> None:
    frames, truth = _moving_disc()
    assert _overlap(_found(frames), truth) > 0.9


def test_silhouettes_that_are_a_pixel_too_large_or_small_are_corrected() -> None:
    frames, truth = _moving_disc()
    for change in (cv2.dilate, cv2.erode):
        rough = np.stack([change(t.astype(np.float32), np.ones((3, 3), np.uint8)) for t in truth])
        refined = refined_coverage(frames, 0.02 + 0.96 * rough)
        assert _overlap(refined > 0.5, truth) > _overlap(rough > 0.5, truth) + 0.02


@pytest.mark.parametrize("size", [(48, 64), (37, 91), (16, 5)])
def test_refined_coverage_is_a_probability_for_each_pixel_of_any_size(size: tuple[int, int]) -> None:
    generator = np.random.default_rng(0)
    frames = generator.integers(0, 255, (6, *size, 3), dtype=np.uint8)
    refined = refined_coverage(frames, generator.random((6, *size), dtype=np.float32))
    assert refined.shape == (6, *size) and refined.dtype == np.float32
    assert refined.min() >= 0 and refined.max() <= 1


def test_uncovered_background_is_the_median_of_the_frames_that_show_it() -> None:
    generator = np.random.default_rng(0)
    frames = generator.integers(0, 255, (7, 8, 9, 3), dtype=np.uint8)
    covered = generator.random((7, 8, 9)) < 0.5
    covered[:, 0, 0], covered[:, 0, 1], covered[1:, 0, 1] = True, False, True
    background = uncovered_background(frames, covered)
    for y, x in np.ndindex(8, 9):
        shown = np.sort(frames[~covered[:, y, x], y, x], axis=0)
        assert background.known[y, x] == (len(shown) >= 2)
        expected = frames[0, y, x] if len(shown) == 0 else shown[(len(shown) - 1) // 2]
        np.testing.assert_array_equal(background.picture[y, x], expected)


def test_input_holds_frame_difference_colour_and_rough_silhouette() -> None:
    frames = np.random.default_rng(0).integers(0, 255, (5, 10, 8, 3), dtype=np.uint8)
    frames[:, :5, :4] = [200, 30, 30]
    coverage = np.full((5, 10, 8), 0.1, np.float32)
    coverage[:, :5, :4] = 0.9
    background = uncovered_background(frames, near_object(coverage))
    whole = outline_input(frames, coverage, shown=np.array([1, 3])).numpy()
    assert whole.shape == (2, 9, 16, 8)
    at, chosen = np.s_[:, :, 9, 6], frames[[1, 3], 9, 6].astype(float)
    np.testing.assert_allclose(whole[at][:, :3], (chosen - 128) / 32, atol=1e-6)
    np.testing.assert_allclose(whole[at][:, 3:6], (chosen - background.picture[9, 6]) / 32, atol=1e-6)
    np.testing.assert_array_equal(whole[:, 6, :10], np.broadcast_to(background.known, (2, 10, 8)))
    np.testing.assert_allclose(whole[:, 7, :5, :4], 1.0)  # this colour is seen inside only
    assert whole[:, 7, 7:10, 5:].max() < 0
    np.testing.assert_allclose(whole[:, 8, :5, :4], np.log(0.905 / 0.105) / 5, rtol=1e-5)
    np.testing.assert_array_equal(whole[:, :, 10:], np.repeat(whole[:, :, 9:10], 6, axis=2))


def test_saved_network_is_read_again(tmp_path: Path) -> None:
    network = OutlineNetwork(SMALL).eval()
    save_network(tmp_path, network, SMALL, model_card="# card\n")
    loaded = load_outline(tmp_path)
    assert loaded.config == SMALL and not loaded.training
    generator = np.random.default_rng(0)
    frames, rough = generator.integers(0, 255, (6, 32, 32, 3), dtype=np.uint8), generator.random((6, 32, 32))
    expected, found = (refined_coverage(frames, rough.astype(np.float32), network=n) for n in (network, loaded))
    np.testing.assert_allclose(found, expected, atol=5e-3)  # stored in float16


def test_bundled_network_is_small_and_better_than_what_it_corrects() -> None:
    metrics = load_outline().config.metrics
    assert metrics["intersection_over_union"] > metrics["before"] + 0.02
    assert sum(path.stat().st_size for path in BUNDLED_OUTLINE.iterdir()) < 2**20


def test_missing_checkpoints_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"outline: .*train-outline"):
        load_outline(tmp_path / "nowhere")
