"""Phases, resampling, and the split of the frames."""

from pathlib import Path

import numpy as np
import pytest

from physconvex import InputError
from physconvex.gap import GapOptions
from physconvex.gap.base.baseline import split_frames
from physconvex.gap.location.where import _spread, block_bootstrap, phases_of
from physconvex.io import Capture


def test_phases_of_a_bounce():
    force = np.array([0, 0, 1, 3, 2, 1, 0, 0, 1, 1.0])
    speed = np.array([1, 2, 2, 1, 1, 1, 1, 1, 0.01, 0.01])
    assert phases_of(force, speed) == (
        "flight", "flight", "impact", "impact", "contact", "contact", "rebound", "rebound", "rest", "rest",
    )  # fmt: skip


def test_phases_without_contact():
    assert set(phases_of(np.zeros(6), np.ones(6))) == {"early motion", "late motion"}


def test_bootstrap_of_a_mean():
    rng = np.random.default_rng(0)
    values = rng.normal(size=400) + 2
    draws = block_bootstrap(values, 1, GapOptions(bootstraps=500))
    assert draws.mean() == pytest.approx(values.mean(), abs=0.02)
    assert draws.std() == pytest.approx(1 / 20, rel=0.35)
    np.testing.assert_array_equal(draws, block_bootstrap(values, 1, GapOptions(bootstraps=500)))


def test_spread_interpolates():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    np.testing.assert_allclose(_spread(points, np.array([1.0, 2, 3, 4]), points), [1, 2, 3, 4], rtol=1e-6)


@pytest.mark.parametrize(("frames", "observed"), [(24, 16), (24, 24), (9, 9)])
def test_frames_serve_one_purpose(frames, observed):
    split = split_frames(Capture(Path("x"), 24.0, frames, observed), np.arange(frames))
    parts = [split.fitted, split.selecting, split.reporting]
    assert sorted(np.concatenate(parts)) == list(range(frames)) and all(len(p) for p in parts)
    assert split.fitted.max() < split.selecting.min() <= split.selecting.max() < split.reporting.min()
    if observed < frames:
        assert len(split.fitted) == observed


def test_too_few_frames():
    with pytest.raises(InputError, match="at least 6"):
        split_frames(Capture(Path("x"), 24.0, 24, 16), np.arange(4))
