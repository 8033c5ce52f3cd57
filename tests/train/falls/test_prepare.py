"""Clips prepared at once are those that inference prepares one by one."""

import numpy as np
import pytest
import torch

from data_gen import CameraConfig
from models import ClipConfig, prepare_clip
from train.falls.prepare import prepare_clips_at_once
from train.falls.views import draw_views

SETTINGS = ClipConfig(window=40, extent=1.7, frames=16, margin=0.1)


@pytest.fixture
def views(falls, generator):
    return draw_views(falls, torch.tensor([0, 1, 0]), CameraConfig(), generator)


def test_as_inference_prepares_them(views):
    windows, moments = prepare_clips_at_once(views.images, views.masks, SETTINGS)
    for k in range(3):
        one = prepare_clip(
            views.images[k].round().byte().numpy(),
            mask=255 * (views.masks[k] > 0).byte().numpy(),
            config=SETTINGS,
        )
        assert moments[k].numpy() == pytest.approx(one.moments, abs=0.04)
        assert np.abs(moments[k].numpy() - one.moments).mean() < 0.004
        difference = np.abs(windows[k].numpy() - one.windows)
        assert difference.mean() < 1.5
        # and they show something
        assert np.abs(one.windows.astype(float) - 127).mean() > 10


def test_views_keep_the_whole_path_in_sight(views):
    assert views.masks.amax(dim=(2, 3)).min() == 1
    border = torch.cat([views.masks[:, :, 0], views.masks[:, :, -1], views.masks[..., 0], views.masks[..., -1]], dim=-1)
    assert border.mean() < 0.01


def test_turns_are_those_of_the_cameras(views):
    for turn in views.turn:
        assert torch.allclose(turn @ turn.T, torch.eye(3), atol=1e-5) and float(torch.det(turn)) == pytest.approx(1)
        assert turn[2].tolist() == [0, 0, 1]


def test_a_motion_to_the_right_goes_right(falls, generator):
    """What the turned states call x is what the silhouettes do."""
    from train.falls.world import turned

    chosen = torch.zeros(12, dtype=torch.long)
    views = draw_views(falls, chosen, CameraConfig(), generator)
    moments = prepare_clips_at_once(views.images, views.masks, SETTINGS)[1][:, :, 0]
    shift = turned(falls.states[chosen], views.turn)[:, :, 0]
    seen, true = moments[:, 7] - moments[:, 0], shift[:, 7]
    clear = true.abs() > 0.05
    assert clear.sum() >= 4
    assert bool((torch.sign(seen[clear]) == torch.sign(true[clear])).all())
