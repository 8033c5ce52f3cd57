"""The captures that come with the project are what the script makes of the recordings."""

import sys

import numpy as np
import pytest

from examples import make_captures
from physconvex.io import load_capture

FOLDERS = [f"silicone_beam_{name}" for name in make_captures.RECORDINGS]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out, given = tmp_path_factory.mktemp("captures"), sys.argv
    sys.argv = ["make_captures.py", "--out", str(out)]
    try:
        make_captures.main()
    finally:
        sys.argv = given
    return out


@pytest.mark.parametrize("name", FOLDERS)
def test_bundled_captures_are_the_recordings(made, name):
    ours, again = (load_capture(folder / name) for folder in (make_captures.BUNDLED, made))
    assert ours.fps == again.fps == 100.0 and ours.frames == again.frames and ours.observed_frames < ours.frames
    np.testing.assert_allclose(ours.tracks().positions, again.tracks().positions, atol=1e-12)
    np.testing.assert_array_equal(ours.tets().vertices, again.tets().vertices)
    sunk = ours.tracks().positions[:, :, 2].min(axis=0) - ours.tracks().rest[:, 2]
    assert (sunk < (-0.008 if "gravity" in name else -0.03)).all()  # it is let go, and a load pulls it farther down


def test_the_film_of_the_toy_can_be_compared():
    bus = load_capture(make_captures.BUNDLED / "school_bus")
    assert bus.tracks() is None and len(bus.mesh().faces) > 1000
    camera = bus.cameras[0]
    frames, masks = bus.video(camera.name).frames, bus.mask(camera.name)
    assert len(frames) == len(masks) == bus.frames == 24
    low, high = bus.mesh().bounds
    pixels, _ = camera.project(np.array([(low + high) / 2]))
    column, row = pixels[0].astype(int)
    assert masks[0][row, column]  # frame 0 is the rest state


@pytest.mark.parametrize("name", FOLDERS)
def test_they_do_not_tell_what_is_to_be_found(name):
    files = {path.name for path in (make_captures.BUNDLED / name).iterdir()}
    assert files == {"capture.json", "tracks.npz", "tets.npz", "boundary.npz"}
