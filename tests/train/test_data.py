"""From the data set to batches: labels, frames of reference, plan, cache."""

from pathlib import Path

import numpy as np
import pytest
import torch

from models import prepare_clip
from physconvex import InputError
from physconvex.io import look_at
from train import TrainConfig, TrainingClips, load_train_config, prepare_clips, read_clips, smoothed_target
from train.cache import PreparedClips
from train.data import Item, Plan, batches, collate
from train.records import camera_aligned_axes
from train.validation import density_metrics


@pytest.mark.parametrize("azimuth", [0.0, 0.7, 3.0, -1.6])
def test_object_frame_follows_the_camera(azimuth: float) -> None:
    """For a camera at any azimuth and height: x to the right in the image, y away from it, z up."""
    eye = np.array([4 * np.sin(azimuth), -4 * np.cos(azimuth), 1.5])
    camera = look_at(eye, (0, 0, 0.3), width=64, height=64, vertical_field_of_view=0.6)
    axes = camera_aligned_axes(camera.transform_matrix)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    expected = [[np.cos(azimuth), np.sin(azimuth), 0], [-np.sin(azimuth), np.cos(azimuth), 0], [0, 0, 1]]
    np.testing.assert_allclose(axes, expected, atol=1e-9)


def test_samples_are_centred_and_in_units_of_the_size(tiny_data: Path) -> None:
    clip = read_clips([tiny_data], "test")[0]
    samples = clip.samples
    middle = (samples.points.min(axis=0) + samples.points.max(axis=0)) / 2
    np.testing.assert_allclose(middle, 0, atol=1e-6)
    assert np.ptp(samples.points, axis=0).max() <= 1.0
    assert samples.volume_weights.sum() == pytest.approx(1.0, abs=1e-5)


def test_unknown_split_or_folder_is_named(tiny_data: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="manifest"):
        read_clips([tmp_path])
    assert len(read_clips([tiny_data])) == 72


def test_cache_holds_what_inference_prepares(tiny_data: Path, tiny_cache: Path, tiny_config: TrainConfig) -> None:
    clips = read_clips([tiny_data], "test")
    prepared = prepare_clips(clips, tiny_config.clip, tiny_cache, workers=0)
    expected = prepare_clip(clips[3].record.frames(), fps=clips[3].fps, config=tiny_config.clip)
    np.testing.assert_array_equal(prepared.windows[3], expected.windows)
    np.testing.assert_array_equal(prepared.clip(3).moments, expected.moments)
    assert prepared.clip(3).fps == expected.fps


def test_a_cache_that_was_cut_off_is_finished(tiny_data: Path, tmp_path: Path, tiny_config: TrainConfig) -> None:
    clips = read_clips([tiny_data], "test")
    seen: list[int] = []

    def stop_after_one_chunk(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare_clips(clips, tiny_config.clip, tmp_path, workers=0, progress=stop_after_one_chunk)
    whole = prepare_clips(clips, tiny_config.clip, tmp_path, workers=0, progress=lambda done, total: seen.append(done))
    assert seen == [12]  # the first eight were there
    assert (whole.fps > 0).all() and whole.valid.any(axis=1).all()
    assert isinstance(whole, PreparedClips)


def test_true_masks_are_shown_for_the_share_asked_for(
    tiny_data: Path, tmp_path: Path, tiny_config: TrainConfig
) -> None:
    clips = read_clips([tiny_data], "validation")
    found, known = (
        prepare_clips(clips, tiny_config.clip, tmp_path, workers=0, true_mask_share=share) for share in (0.0, 1.0)
    )
    assert not np.array_equal(found.mask, known.mask)
    np.testing.assert_array_equal(found.moments, known.moments)  # both kinds, in both
    assert (known.confidence == 1).all()


def test_batches_are_a_function_of_seed_and_step(tiny_data: Path, tiny_cache: Path, tiny_config: TrainConfig) -> None:
    clips = read_clips([tiny_data], "train")
    prepared = prepare_clips(clips, tiny_config.clip, tiny_cache, workers=0, true_mask_share=0.2)
    training = TrainingClips(clips, prepared, augmentation=tiny_config.augment, modes=3, seed=5)
    plan = Plan.of(tiny_config, len(training))
    assert plan.steps == 24
    from_start = list(batches(training, plan, first_step=0))
    from_middle = list(batches(training, plan, first_step=13))
    assert len(from_start) == 24
    for one, other in zip(from_start[13:], from_middle, strict=True):
        assert torch.equal(one.clips.moments, other.clips.moments)
        assert torch.equal(one.clips.windows, other.clips.windows)
        assert torch.equal(one.targets.displacements, other.targets.displacements)
    halves = [list(batches(training, plan, first_step=20, rank=rank, world=2)) for rank in (0, 1)]
    for whole, first, second in zip(from_start[20:], *halves, strict=True):
        together = torch.cat([first.clips.moments, second.clips.moments])
        assert torch.equal(together.sum(dim=(1, 2)).sort().values, whole.clips.moments.sum(dim=(1, 2)).sort().values)
    assert from_start[0].clips.windows.shape == (8, 16, 32, 32, 4)


def test_every_clip_once_an_epoch(tiny_config: TrainConfig) -> None:
    plan = Plan.of(tiny_config, 48)
    epochs: dict[int, list[int]] = {}
    for number in range(plan.steps):
        epochs.setdefault(plan.step(number).epoch, []).extend(plan.step(number).clips)
    assert len(epochs) == 4 and all(sorted(seen) == list(range(48)) for seen in epochs.values())
    assert epochs[0] != epochs[1]
    with pytest.raises(InputError, match="no multiple of 3 processes"):
        Plan.of(tiny_config, 48, world=3)


def test_labels_reach_the_targets_unchanged(tiny_data: Path, tiny_cache: Path, tiny_config: TrainConfig) -> None:
    clips = read_clips([tiny_data], "test")
    prepared = prepare_clips(clips, tiny_config.clip, tiny_cache, workers=0)
    plain = TrainingClips(clips, prepared, augmentation=None, modes=3, seed=0)
    targets = collate([plain[Item(0, k)] for k in range(4)]).targets
    expected = [np.log10(c.youngs_modulus / (c.density * 9.81 * c.object_size)) for c in clips[:4]]
    np.testing.assert_allclose(targets.log10_stiffness, expected, rtol=1e-6)
    np.testing.assert_allclose(targets.poisson_ratio, [c.poisson_ratio for c in clips[:4]], rtol=1e-6)


def test_smoothed_target_keeps_mean_and_mass(tiny_config: TrainConfig) -> None:
    bins = tiny_config.network.stiffness
    values = torch.tensor([1.03, 2.5, -0.5, 99.0])
    target = smoothed_target(values, bins, 1.0)
    centres = torch.linspace(bins.low, bins.high, bins.bins + 1)[:-1] + (bins.high - bins.low) / bins.bins / 2
    torch.testing.assert_close(target.sum(dim=1), torch.ones(4))
    torch.testing.assert_close((target @ centres)[:2], values[:2], atol=1e-3, rtol=0)
    assert smoothed_target(values, bins, 0.0).sum(dim=1).eq(1).all()
    assert int(target[3].argmax()) == bins.bins - 1


def test_metrics_by_hand() -> None:
    truth = np.array([0.0, 1.0, 2.0, 3.0])
    error, above = np.array([0.1, -0.1, 0.3, 0.1]), np.array([0.2, 0.2, -0.1, 0.2])
    found = density_metrics(truth + error, truth - 0.2, truth + above, truth)
    assert found.mae == pytest.approx(0.15) and found.bias == pytest.approx(0.1)
    assert found.coverage == 0.75 and found.constant_mae == 1.0
    assert density_metrics(truth, truth, truth, truth, constant=0.0).constant_mae == 1.5


def test_configuration_from_yaml(tmp_path: Path) -> None:
    path = tmp_path / "recipe.yaml"
    path.write_text("epochs: 3\naugment: {colour: 0.1}\n")
    config = load_train_config(path, seed=4, epochs=None)
    assert (config.epochs, config.augment.colour, config.seed) == (3, 0.1, 4)
    assert load_train_config("default").network == TrainConfig().network
    path.write_text("epoch: 3\n")
    with pytest.raises(InputError, match="epoch"):
        load_train_config(path)
    with pytest.raises(InputError, match="preset"):
        load_train_config("nothing")
