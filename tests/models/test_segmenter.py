from pathlib import Path

import numpy as np
import pytest
import torch

from models import (
    SegmenterConfig,
    SilhouetteSegmenter,
    block_pixels,
    clip_references,
    load_segmenter,
    object_coverage,
    pad_pictures,
    save_network,
)
from models.appearance import sort_pictures
from models.segmenter import BUNDLED_SEGMENTER
from physconvex import InputError

SMALL = SegmenterConfig(difference_channels=2, channels=(4, 6, 8), rim_channels=4)


@pytest.mark.parametrize("size", [(48, 64), (37, 91), (16, 5)])
def test_coverage_is_a_probability_for_each_pixel_of_any_size(size: tuple[int, int]) -> None:
    frames = np.random.default_rng(0).integers(0, 255, (6, *size, 3), dtype=np.uint8)
    coverage = object_coverage(frames)
    assert coverage.shape == (6, *size) and coverage.dtype == np.float32
    assert coverage.min() >= 0 and coverage.max() <= 1
    np.testing.assert_array_equal(coverage, object_coverage(frames))


def test_stem_sees_differences_to_the_references() -> None:
    network = SilhouetteSegmenter(SMALL)
    pictures = np.random.default_rng(0).integers(0, 255, (4, 16, 16, 3), dtype=np.uint8)
    frames = block_pixels(pictures)
    same = network._differences(frames, frames[:1].expand(3, -1, -1, -1))
    bias = network.stem.bias[None, :, None, None].expand_as(same[:1])
    torch.testing.assert_close(same[0, :6], bias[0, :6], atol=1e-5, rtol=0)
    assert (same[1, :6] - bias[0, :6]).abs().max() > 0.1
    torch.testing.assert_close(same[:, 6:], network.stem(frames)[:, 6:])


def test_blocks_hold_the_pixels_of_two_rows_and_columns() -> None:
    pictures = np.random.default_rng(0).integers(0, 255, (1, 16, 32, 3), dtype=np.uint8)
    blocks = block_pixels(pictures)
    assert blocks.shape == (1, 12, 8, 16)
    expected = (pictures[0, 6:8, 10:12].reshape(-1).astype(np.float32) - 128) / 32
    np.testing.assert_allclose(blocks[0, :, 3, 5], expected)


def test_references_are_median_first_and_last() -> None:
    frames = np.random.default_rng(0).integers(0, 255, (7, 8, 8, 3), dtype=np.uint8)
    median, first, last = clip_references(frames)
    np.testing.assert_array_equal(median, np.median(frames, axis=0))
    np.testing.assert_array_equal(first, frames[0])
    np.testing.assert_array_equal(last, frames[6])


@pytest.mark.parametrize("count", [1, 2, 5, 24])
def test_pictures_are_sorted(count: int) -> None:
    pictures = np.random.default_rng(0).integers(0, 255, (count, 5, 4), dtype=np.uint8)
    np.testing.assert_array_equal(sort_pictures(list(pictures)), np.sort(pictures, axis=0))


def test_padding_repeats_the_border() -> None:
    pictures = np.random.default_rng(0).integers(0, 255, (2, 17, 16, 3), dtype=np.uint8)
    padded = pad_pictures(pictures)
    assert padded.shape == (2, 32, 16, 3)
    np.testing.assert_array_equal(padded[:, :17], pictures)
    np.testing.assert_array_equal(padded[:, 31], pictures[:, 16])


def test_saved_segmenter_is_read_again(tmp_path: Path) -> None:
    network = SilhouetteSegmenter(SMALL).eval()
    save_network(tmp_path, network, SMALL, model_card="# card\n")
    frames = np.random.default_rng(0).integers(0, 255, (6, 32, 32, 3), dtype=np.uint8)
    loaded = load_segmenter(tmp_path)
    assert loaded.config == SMALL and not loaded.training
    expected, found = (object_coverage(frames, segmenter=n) for n in (network, loaded))
    np.testing.assert_allclose(found, expected, atol=5e-3)  # stored in float16


def test_bundled_segmenter_is_small_and_says_how_good_it_is() -> None:
    assert load_segmenter().config.metrics["intersection_over_union"] > 0.8
    assert sum(path.stat().st_size for path in BUNDLED_SEGMENTER.iterdir()) < 2**20


def test_missing_or_unfitting_checkpoints_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="segmenter: "):
        load_segmenter(tmp_path / "nowhere")
    save_network(tmp_path, SilhouetteSegmenter(SMALL), SegmenterConfig(), model_card="")
    with pytest.raises(InputError, match="train-segmenter"):
        load_segmenter(tmp_path)
