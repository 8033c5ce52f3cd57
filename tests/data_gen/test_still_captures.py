"""Still captures: pictures with alpha that agree with the cameras, and can be read back."""

import numpy as np
import pytest
import trimesh

from data_gen import FLAT, ObjectMesh, StillViews, write_still_capture
from physconvex import InputError
from physconvex.io import load_capture


def test_a_still_capture_can_be_read_back_and_shows_the_colours(tmp_path):
    box = trimesh.creation.box((0.1, 0.2, 0.1))
    colours = np.tile(np.array([[200, 100, 50]], np.uint8), (len(box.vertices), 1))
    body = ObjectMesh(np.asarray(box.vertices), np.asarray(box.faces), "box", "user", vertex_colors=colours)
    groups = (StillViews(3, (0.0, -60.0), name="fit"), StillViews(1, (10.0,), phase=0.5, name="held"))
    write_still_capture(tmp_path / "still", body, groups, size=32, lighting=FLAT)
    capture = load_capture(tmp_path / "still")
    assert [camera.name for camera in capture.cameras] == ["fit0", "fit1", "fit2", "held0"]
    np.testing.assert_allclose(capture.mesh().bounds, box.bounds, atol=1e-6)
    for camera in capture.cameras:
        picture, alpha = capture.first_frame(camera.name)
        assert np.abs(picture[alpha == 255].astype(int) - [200, 100, 50]).max() <= 2
        pixels, _ = camera.project(box.vertices)
        rows, columns = np.nonzero(alpha > 127)
        np.testing.assert_allclose([columns.min(), rows.min()], pixels.min(axis=0), atol=1.1)
        np.testing.assert_allclose([columns.max() + 1, rows.max() + 1], pixels.max(axis=0), atol=1.1)
    with pytest.raises(InputError, match="exists"):
        write_still_capture(tmp_path / "still", body, groups, size=32)
