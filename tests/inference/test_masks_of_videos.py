"""What is told of masks that do not show the whole object, or another state than that at t = 0."""

import json

import numpy as np
import pytest
from PIL import Image

from inference.refinement.mask_notes import check_masks
from physconvex import InputError
from physconvex.io import load_capture, look_at


@pytest.fixture
def capture(tmp_path):
    camera = look_at((1, 0, 0), (0, 0, 0), width=40, height=30, vertical_field_of_view=0.5, name="front")
    content = {"fps": 24.0, "frames": 9, "cameras": [camera.to_json()]}
    (tmp_path / "capture.json").write_text(json.dumps(content))
    return load_capture(tmp_path)


def masks() -> np.ndarray:
    """A square that stays inside."""
    out = np.zeros((9, 30, 40), dtype=bool)
    out[:, 10:20, 10:20] = True
    return out


def test_whole_masks_say_nothing(capture):
    assert check_masks(capture, capture.cameras[0], masks()) == ()


def test_empty_masks_and_an_object_that_leaves_are_told_by_frame(capture):
    seen = masks()
    seen[[3, 4, 5, 8]] = False
    seen[[6, 7], :, 35:] = True
    empty, leaves = check_masks(capture, capture.cameras[0], seen)
    assert "mask is empty in frames 3 to 5, 8;" in empty and "leaves the picture in frames 6 to 7;" in leaves
    seen[0] = False
    with pytest.raises(InputError, match=r"'front': its mask is empty in frame 0.*front_mask\.mp4"):
        check_masks(capture, capture.cameras[0], seen)


def test_a_picture_of_another_state_than_frame_0_is_told(capture):
    still = np.zeros((30, 40), np.uint8)
    still[10:20, 10:20] = 255
    Image.fromarray(still).save(capture.folder / "front_mask.png")
    assert check_masks(capture, capture.cameras[0], masks()) == ()
    Image.fromarray(np.roll(still, 5, axis=0)).save(capture.folder / "front_mask.png")
    (told,) = check_masks(capture, capture.cameras[0], masks())
    assert "front_mask.png and frame 0 of its video show different states" in told and "33 % of their area" in told
