"""Changes of a whole batch against `train.augment`, one by one."""

import numpy as np
import pytest
import torch

from models import mirrored_moments
from train.augment import Sample, flipped, reindexed
from train.config import AugmentConfig
from train.falls.augment import Shown, augment_at_once
from train.motion_states import MIRROR

STILL = {
    "flip_share": 0.0,
    "latest_start": 0,
    "stride_share": 0.0,
    "shorten_share": 0.0,
    "zoom": 0.0,
    "shift": 0.0,
    "colour": 0.0,
    "grey_share": 0.0,
    "mask_share": 0.0,
    "moment_noise": 0.0,
}


@pytest.fixture
def shown(generator) -> Shown:
    """Three clips of sixteen frames, the last one four frames shorter."""
    windows = torch.randint(0, 255, (3, 16, 12, 12, 4), generator=generator).float()
    windows[..., 3] = windows[..., 3].clamp(min=1)
    valid = torch.ones(3, 16, dtype=torch.bool)
    valid[2, 12:] = False
    moments = torch.randn(3, 16, 11, generator=generator)
    moments[..., 3] = moments[..., 2] + 1
    states = 0.3 * torch.randn(3, 16, 19, generator=generator)
    return Shown(windows, moments, valid, torch.full((3,), 0.2), states)


def alone(shown: Shown, k: int) -> Sample:
    arrays = {name: value[k].numpy() for name, value in vars(shown).items() if name != "interval"}
    arrays["windows"] = arrays["windows"].astype(np.uint8)
    return Sample(interval=float(shown.interval[k]), points=np.zeros((1, 3), np.float32), **arrays)


def assert_equal(found: Shown, k: int, wanted: Sample) -> None:
    for name in ("windows", "moments", "states"):
        value = getattr(found, name)[k].numpy()
        assert value == pytest.approx(getattr(wanted, name).astype(np.float32), abs=2e-3), name
    assert np.array_equal(found.valid[k].numpy(), wanted.valid)
    assert float(found.interval[k]) == pytest.approx(wanted.interval)


def test_nothing_asked_is_nothing_done_but_what_refers_to_the_first_frame(shown, generator):
    found = augment_at_once(shown, AugmentConfig(**STILL), generator)
    for k in range(3):
        assert_equal(found, k, reindexed(alone(shown, k), 0, int(shown.valid[k].sum()), 1))


def test_every_other_frame(shown, generator):
    found = augment_at_once(shown, AugmentConfig(**STILL | {"stride_share": 1.0}), generator)
    assert_equal(found, 0, reindexed(alone(shown, 0), 0, 16, 2))
    assert_equal(found, 2, reindexed(alone(shown, 2), 0, 12, 1))  # too short for it


def test_mirrored(shown, generator):
    found = augment_at_once(shown, AugmentConfig(**STILL | {"flip_share": 1.0}), generator)
    for k in range(3):
        assert_equal(found, k, flipped(reindexed(alone(shown, k), 0, int(shown.valid[k].sum()), 1)))
    assert np.array_equal(MIRROR, np.array([-1.0 if n < 0 else 1.0 for n in MIRROR], np.float32))
    assert mirrored_moments(shown.moments.numpy()).shape == shown.moments.shape


def test_later_starts_and_earlier_ends(shown, generator):
    config = AugmentConfig(**STILL | {"latest_start": 3, "shorten_share": 1.0})
    counts = set()
    for _ in range(30):
        found = augment_at_once(shown, config, generator)
        count = int(found.valid[0].sum())
        counts.add(count)
        assert any(
            np.allclose(found.windows[0, :count].numpy(), shown.windows[0, start : start + count].numpy(), atol=1e-2)
            for start in range(4)
        )
        assert bool((found.windows[0, count:] - found.windows[0, count - 1]).abs().max() < 1e-2) if count < 16 else True
    assert len(counts) > 4 and min(counts) >= 8


def test_colours_change_and_what_is_not_the_object_stays_grey(shown, generator):
    windows = shown.windows.clone()
    windows[:, :, :6, :, 3] = 0
    windows[:, :, :6, :, :3] = 127
    given = Shown(windows, shown.moments, shown.valid, shown.interval, shown.states)
    found = augment_at_once(given, AugmentConfig(**STILL | {"colour": 0.3}), generator)
    assert bool((found.windows[:, :, :6, :, :3] == 127).all())
    assert float((found.windows[:, :, 6:, :, :3] - windows[:, :, 6:, :, :3]).abs().mean()) > 3
    grey = augment_at_once(given, AugmentConfig(**STILL | {"grey_share": 1.0}), generator).windows[:, :, 6:, :, :3]
    assert float((grey.amax(dim=-1) - grey.amin(dim=-1)).max()) < 1e-2


def test_the_same_numbers_give_the_same_clips(shown):
    first, second = (
        augment_at_once(shown, AugmentConfig(), torch.Generator().manual_seed(3)).windows for _ in range(2)
    )
    assert torch.equal(first, second)
