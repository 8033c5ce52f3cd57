from pathlib import Path

import numpy as np
import pytest
import torch

from models import SegmenterConfig, load_segmenter
from physconvex import InputError
from train.finder_loop import FinderResult
from train.segmentation import SegmentationConfig, segmentation_loss, train_segmenter
from train.segmentation_data import MaskedClip, SegmentationAugmentation, augmented

CONFIG = SegmentationConfig(
    steps=40,
    batch=2,
    average=0.5,
    learning_rate=5e-3,
    network=SegmenterConfig(difference_channels=4, channels=(8, 8, 8), rim_channels=4),
    augmentation=SegmentationAugmentation(lengths=(6,), largest_side=48),
)


@pytest.fixture(scope="module")
def trained(tiny_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[FinderResult, Path]:
    out = tmp_path_factory.mktemp("segmenter")
    return train_segmenter(CONFIG, [tiny_data], out), out


def test_training_lowers_the_loss(trained: tuple[FinderResult, Path]) -> None:
    losses = trained[0].losses
    assert len(losses) == CONFIG.steps
    assert np.mean(losses[-10:]) < 0.8 * np.mean(losses[:10])


def test_checkpoint_says_what_it_was_measured(trained: tuple[FinderResult, Path]) -> None:
    result, out = trained
    overlap = result.metrics["intersection_over_union"]
    assert 0 <= overlap <= 1
    assert load_segmenter(out).config.metrics == result.metrics == {"intersection_over_union": overlap}
    card = (out / "model_card.md").read_text(encoding="utf-8")
    assert f"{overlap:.3f}" in card and "SHA-256" in card


def test_same_seed_gives_the_same_network(trained: tuple[FinderResult, Path], tiny_data: Path, tmp_path: Path) -> None:
    again = train_segmenter(CONFIG, [tiny_data], tmp_path)
    assert again.losses == trained[0].losses
    expected = load_segmenter(trained[1]).state_dict()
    for name, value in load_segmenter(tmp_path).state_dict().items():
        torch.testing.assert_close(value, expected[name], rtol=0, atol=0)


def test_no_data_set_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"manifest\.json"):
        train_segmenter(CONFIG, [tmp_path], tmp_path / "out")


def test_loss_prefers_the_truth() -> None:
    truth = torch.zeros(2, 16, 16, dtype=torch.bool)
    truth[:, 4:9, 5:12] = True
    right = torch.where(truth, 8.0, -8.0)
    assert segmentation_loss(right, truth) < 0.01
    assert segmentation_loss(-right, truth) > segmentation_loss(torch.zeros(2, 16, 16), truth) > 1.0


def test_augmentation_moves_frames_and_mask_together() -> None:
    frames = np.full((24, 64, 64, 3), 90, np.uint8)
    mask = np.zeros((24, 64, 64), bool)
    for k in range(24):
        mask[k, 10 + k : 30 + k, 8:28] = True
    frames[mask] = [220, 40, 130]
    options = SegmentationAugmentation(recoloured=0.0, noise=0.0)
    for seed in range(8):
        example = augmented(MaskedClip(frames, mask), options, np.random.default_rng(seed))
        assert example.frames.shape[:3] == example.mask.shape and 6 <= len(example.mask) <= 16
        seen = np.abs(example.frames.astype(int) - [220, 40, 130]).sum(axis=-1) < 100
        assert (seen == example.mask).mean() > 0.98


def test_augmentation_depends_on_the_seed_alone() -> None:
    generator = np.random.default_rng(0)
    clip = MaskedClip(
        generator.integers(0, 255, (12, 32, 32, 3), dtype=np.uint8),
        generator.random((12, 32, 32)) > 0.5,
    )
    first, second, other = (
        augmented(clip, SegmentationAugmentation(), np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first.frames, second.frames)
    np.testing.assert_array_equal(first.mask, second.mask)
    assert first.frames.shape != other.frames.shape or (first.frames != other.frames).any()
