"""Long captures: their first frames."""

import numpy as np
import pytest
import trimesh

from physconvex.gap.base.baseline import shortened
from physconvex.io import Boundary, Capture, Tracks, load_capture, save_capture


@pytest.fixture
def long(tmp_path):
    folder = tmp_path / "long"
    points = np.random.default_rng(0).normal(size=(5, 3))
    positions = points + np.linspace(0, 1, 30)[:, None, None]
    moved = np.zeros((30, 2, 3))
    save_capture(
        Capture(folder, 50.0, 30, 30), mesh=trimesh.creation.box(),
        tracks=Tracks(points, positions, np.full((30, 5), 1e-3)),
        boundary=Boundary(clamped_vertices=np.array([0, 1]), motion=moved),
    )  # fmt: skip
    return load_capture(folder)


def test_first_frames_of_everything(long):
    first = shortened(long, 12)
    assert (first.frames, first.observed_frames, len(first.times)) == (12, 8, 12)
    np.testing.assert_array_equal(first.tracks().positions, long.tracks().positions[:12])
    assert first.tracks().sigma.shape == (12, 5) and first.boundary().motion.shape == (12, 2, 3)
    assert first.mesh().is_watertight and first.fps == 50.0


def test_short_captures_stay_as_they_are(long):
    assert shortened(long, 30) is long
