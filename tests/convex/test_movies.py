"""Films: the field stays in view from all round, frames are pictures of the fields given."""

import itertools
from pathlib import Path

import numpy as np
import pytest
import torch
import typer
from PIL import Image
from typer.testing import CliRunner, Result

from physconvex import InputError
from physconvex.convex import advect, affine_map, write_ply
from physconvex.io import read_video
from physconvex.render import film, orbit
from physconvex.render.commands import film_command
from tests.convex.fields import random_field


@pytest.mark.parametrize(("width", "height"), [(32, 32), (48, 24), (24, 48)])
def test_an_orbit_sees_the_whole_field_from_all_round(width, height):
    field = random_field(5, seed=1)
    cameras = orbit(field, 8, width=width, height=height)
    points = field.points.reshape(-1, 3).numpy()
    for camera in cameras:
        pixels, depth = camera.project(points)
        assert (depth > 0).all() and (pixels >= 0).all() and (pixels <= [width, height]).all()
    around = np.array([camera.position for camera in cameras])
    np.testing.assert_allclose(around.mean(axis=0)[:2], 0.5 * (points.min(axis=0) + points.max(axis=0))[:2], atol=1e-9)
    with pytest.raises(InputError, match="orbit"):
        orbit(field, 0)


def test_a_film_shows_each_field_in_turn():
    field = random_field(3, seed=2, dtype=torch.float32)
    camera = orbit(field, 1, width=24, height=24)[0]
    moved = advect(field, affine_map(torch.eye(3), torch.tensor([9.0, 0.0, 0.0])))
    frames = list(film([field, moved], itertools.repeat(camera), background=torch.zeros(3)))
    assert [frame.shape for frame in frames] == [(24, 24, 3)] * 2 and frames[0].dtype == np.uint8
    assert frames[0].max() > 0 and frames[1].max() == 0  # out of sight


def run(*arguments: object) -> Result:
    """The command `physconvex film`."""
    app = typer.Typer()
    app.command()(film_command)
    return CliRunner().invoke(app, [*map(str, arguments), "--size", "32", "--no-progress"])


def test_the_command_films_still_and_moving_fields_and_draws_pictures(tmp_path: Path) -> None:
    field = random_field(3, seed=2, dtype=torch.float32)
    for k in range(3):
        shift = affine_map(torch.eye(3), torch.tensor([1.0 * k, 0.0, 0.0]))
        write_ply(advect(field, shift), tmp_path / f"frame{k}.ply")
    assert run(tmp_path / "frame0.ply", "--out", tmp_path / "round.mp4", "--frames", 5).exit_code == 0
    assert read_video(tmp_path / "round.mp4").frames.shape == (5, 32, 32, 3)
    assert run(tmp_path, "--out", tmp_path / "moving.mp4").exit_code == 0
    moving = read_video(tmp_path / "moving.mp4").frames
    assert len(moving) == 3
    middles = [np.argwhere((frame < 200).any(axis=-1))[:, 1].mean() for frame in moving]
    assert middles[0] < middles[1] - 2 < middles[2] - 4  # seen from −y, x points to the right
    assert run(tmp_path / "frame0.ply", "--out", tmp_path / "one.png").exit_code == 0
    expected = next(film([field], orbit(field, 1, width=32, height=32)))
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "one.png")), expected)
    refused = run(tmp_path / "frame0.ply", "--out", tmp_path / "one.gif")
    assert isinstance(refused.exception, InputError) and ".mp4 or .png" in str(refused.exception)
