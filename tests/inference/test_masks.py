"""Masks that are found in the videos of a capture, by the command and by the function."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import typer
from PIL import Image
from typer.testing import CliRunner

from inference import find_masks
from inference.masks import masks_command
from physconvex import InputError
from physconvex.io import Capture, load_capture, look_at, save_capture

BUS = Path("examples/captures/school_bus")


@pytest.fixture
def unmasked(tmp_path):
    """The bus without its masks."""
    return Path(shutil.copytree(BUS, tmp_path / "bus", ignore=shutil.ignore_patterns("*_mask*")))


def run(*arguments):
    app = typer.Typer()
    app.command()(masks_command)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_the_masks_of_a_film_are_found_and_read_by_others(unmasked):
    assert load_capture(unmasked).mask("view0") is None
    found = run(unmasked)
    assert found.exit_code == 0 and "camera view0: confidence 0." in found.stdout and "masks.jpg" in found.stdout
    masks, truth = load_capture(unmasked).mask("view0"), load_capture(BUS).mask("view0")
    shared = (masks & truth).sum(axis=(1, 2)) / (masks | truth).sum(axis=(1, 2))
    assert shared.mean() > 0.95 and shared.min() > 0.85
    with Image.open(unmasked / "masks.jpg") as sheet:
        assert sheet.size == (720, 240)


def test_masks_that_are_there_stay_unless_asked(unmasked):
    given = BUS / "view0_mask.mp4"
    shutil.copy(given, unmasked)
    assert json.loads(run(unmasked, "--json").stdout) == {"view0": 1.0}
    assert (unmasked / "view0_mask.mp4").read_bytes() == given.read_bytes()
    assert dict(find_masks(unmasked, redo=True))["view0"] < 1.0
    assert (unmasked / "view0_mask.mp4").read_bytes() != given.read_bytes()


def test_cameras_without_a_moving_object_are_named_and_the_others_go_on(tmp_path):
    bus, camera = load_capture(BUS), look_at((1, 0, 0), (0, 0, 0), width=64, height=64, vertical_field_of_view=0.5)
    size = {"width": bus.cameras[0].w, "height": bus.cameras[0].h, "vertical_field_of_view": 0.5}
    cameras = (
        look_at((1, 0, 0), (0, 0, 0), name="empty", width=64, height=64, vertical_field_of_view=0.5),
        look_at((0, 1, 0), (0, 0, 0), name="bus", **size),
    )
    still = np.full((bus.frames, 64, 64, 3), 90, np.uint8)
    videos = {"empty": still, "bus": bus.video("view0").frames}
    save_capture(Capture(tmp_path / "two", bus.fps, bus.frames, bus.frames, cameras), videos=videos)
    found = run(tmp_path / "two")
    assert found.exit_code == 1
    assert "camera 'empty': no object is found that moves" in found.stdout and "add empty_mask.mp4" in found.stdout
    assert load_capture(tmp_path / "two").mask("empty") is None
    assert load_capture(tmp_path / "two").mask("bus").any()
    with pytest.raises(InputError, match="'side'"):
        list(find_masks(tmp_path / "two", ["side"]))
    save_capture(Capture(tmp_path / "still", 24.0, 2, 2, (camera,)), stills={camera.name: still[0]})
    with pytest.raises(InputError, match="no camera has a video"):
        list(find_masks(tmp_path / "still"))
