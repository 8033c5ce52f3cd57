from pathlib import Path

import numpy as np
import pytest
import torch

from models import OutlineConfig, load_outline
from train.finder_loop import FinderResult
from train.outline import OutlineTraining, outline_loss, train_outline
from train.outline_data import RoughClip, degraded
from train.segmentation_data import SegmentationAugmentation, rearranged, resized

CONFIG = OutlineTraining(steps=40, batch=2, average=0.5, network=OutlineConfig(channels=(8, 8, 8)))


@pytest.fixture(scope="module")
def trained(tiny_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[FinderResult, Path]:
    out = tmp_path_factory.mktemp("outline")
    return train_outline(CONFIG, [tiny_data], out), out


def test_training_lowers_the_loss(trained: tuple[FinderResult, Path]) -> None:
    losses = trained[0].losses
    assert len(losses) == CONFIG.steps
    assert np.mean(losses[-10:]) < 0.8 * np.mean(losses[:10])


def test_checkpoint_says_what_it_was_measured(trained: tuple[FinderResult, Path]) -> None:
    result, out = trained
    metrics = load_outline(out).config.metrics
    assert metrics == result.metrics and metrics.keys() == {"intersection_over_union", "before"}
    card = (out / "model_card.md").read_text(encoding="utf-8")
    assert f"{metrics['intersection_over_union']:.3f}" in card and "SHA-256" in card


def test_same_seed_gives_the_same_losses(trained: tuple[FinderResult, Path], tiny_data: Path, tmp_path: Path) -> None:
    assert train_outline(CONFIG, [tiny_data], tmp_path).losses == trained[0].losses


def test_loss_prefers_the_truth() -> None:
    truth = torch.zeros(2, 16, 16, dtype=torch.bool)
    truth[:, 4:9, 5:12] = True
    right = torch.where(truth, 8.0, -8.0)
    assert outline_loss(right, truth) < 0.05
    assert outline_loss(-right, truth) > outline_loss(torch.zeros(2, 16, 16), truth) > 1.0


def _square(side: int = 20) -> RoughClip:
    mask = np.zeros((8, 40, 48), np.uint8)
    for k in range(8):
        mask[k, 5 + k : 5 + k + side, 8 : 8 + side] = 255
    return RoughClip(np.repeat(mask[..., None], 3, axis=3), mask > 127, mask.copy())


def test_degraded_clips_keep_frames_and_truth() -> None:
    clip, changed = _square(), 0
    for seed in range(12):
        worse = degraded(clip, np.random.default_rng(seed))
        np.testing.assert_array_equal(worse.frames, clip.frames)
        np.testing.assert_array_equal(worse.mask, clip.mask)
        changed += (worse.rough != clip.rough).any()
    assert 4 <= changed <= 12
    np.testing.assert_array_equal(clip.rough > 127, clip.mask)
    first, second = (degraded(clip, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first.rough, second.rough)


def test_rearranged_clips_keep_frames_truth_and_rough_silhouette_together() -> None:
    sizes = set()
    for seed in range(12):
        options, generator = SegmentationAugmentation(lengths=(4, 6)), np.random.default_rng(seed)
        clip = resized(rearranged(_square(), options, generator), options, generator)
        assert clip.frames.shape[:3] == clip.mask.shape == clip.rough.shape and len(clip.mask) in (4, 6)
        assert ((clip.frames[..., 0] > 127) == clip.mask).all()
        assert ((clip.rough > 127) == clip.mask).all()
        sizes.add(clip.mask.shape[1:])
    assert len(sizes) > 3
