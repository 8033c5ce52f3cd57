"""Captures: what is written can be read back, agrees with the simulation, and says nothing about the truth."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from data_gen import RingOptions, capture_folder, generate_captures, load_config
from data_gen.captures import CaptureTask, make_capture
from data_gen.commands import app
from data_gen.generate import SuccessfulDrop, simulate_with_replacements
from physconvex import InputError
from physconvex.io import load_capture

SMALL = [
    "video={frames: 4, width: 64, height: 48, supersampling: 1}",
    "solver={target_nodes: 100, landing_nodes: 20, steps_per_frame: 2}",
    "camera.views=2",
    "motion.drop_height=[0.1, 0.2]",
    "samples={points: 8, modes: 2}",
]
CONFIG = load_config("captures", overrides=SMALL)
OPTIONS = RingOptions(markers=5, marker_noise=1e-4)


@pytest.fixture(scope="module")
def success() -> SuccessfulDrop:
    return simulate_with_replacements(CONFIG, 3, 0)[0]


@pytest.fixture(scope="module")
def capture(tmp_path_factory, success):
    root = tmp_path_factory.mktemp("captures")
    patch = pytest.MonkeyPatch()
    patch.setattr("data_gen.captures.simulate_with_replacements", lambda *_: (success, ()))
    for folder in (root / "one", root / "two"):
        make_capture(CaptureTask(folder, CONFIG, 3, 0, OPTIONS))
    patch.undo()
    return load_capture(capture_folder(root / "one", 0))


def test_a_capture_can_be_read_back(capture, success):
    assert (capture.fps, capture.frames, capture.observed_frames) == (24.0, 4, 2)
    assert [camera.name for camera in capture.cameras] == ["camera0", "camera1"]
    assert capture.floor.friction == success.drop.friction
    np.testing.assert_allclose(capture.initial_velocity, success.drop.initial_velocity)
    for camera in capture.cameras:
        assert capture.video(camera.name).frames.shape == (4, 48, 64, 3)
        assert capture.mask(camera.name).any(axis=(1, 2)).all()


def test_the_mesh_lies_where_the_drop_starts_and_keeps_its_colours(capture, success):
    mesh = capture.mesh()
    np.testing.assert_allclose(mesh.vertices, success.drop.placed(success.drop.body.vertices), atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, success.drop.body.faces)
    assert len(np.unique(mesh.visual.vertex_colors[:, :3], axis=0)) > 2
    assert capture.object_size == pytest.approx(success.drop.size, rel=1e-6)


def test_the_tetrahedra_are_linear_and_lie_on_the_simulated_ones(capture, success):
    tets, simulated = capture.tets(), success.simulated.mesh
    assert tets.order == 1
    assert len(tets.tets) == len(simulated.tets)
    np.testing.assert_allclose(tets.vertices[tets.tets], simulated.vertices[simulated.corner_tets])


def test_tracks_follow_the_surface_within_their_noise(capture, success):
    tracks = capture.tracks()
    rest = success.drop.placed(success.drop.body.vertices)
    place = [int(np.abs(rest - point).sum(axis=1).argmin()) for point in tracks.rest]
    error = tracks.positions - success.simulated.surface[:, place]
    assert tracks.positions.shape == (4, 5, 3)
    np.testing.assert_array_equal(tracks.sigma, 1e-4)
    assert 0.5e-4 < error.std() < 1.5e-4  # 60 normal draws


def test_masks_show_the_surface_where_the_cameras_project_it(capture, success):
    for camera in capture.cameras:
        pixels, _ = camera.project(success.simulated.surface)
        for mask, points in zip(capture.mask(camera.name), pixels, strict=True):
            rows, columns = np.nonzero(mask)
            low, high = points.min(axis=0), points.max(axis=0)
            np.testing.assert_allclose([columns.min(), rows.min()], low, atol=1.6)
            np.testing.assert_allclose([columns.max() + 1, rows.max() + 1], high, atol=1.6)


def test_cameras_stand_in_a_ring_at_one_height_and_see_one_room(capture):
    first, second = capture.cameras
    directions = np.array([camera.rotation[:2, 2] for camera in (first, second)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert directions[0] @ directions[1] < np.cos(np.deg2rad(160))  # opposite within twice 10 degrees
    assert first.rotation[2, 2] == pytest.approx(second.rotation[2, 2])
    assert first.fl_x == second.fl_x


def test_truth_lies_apart_and_captures_repeat_themselves(capture, success):
    stated = (capture.folder / "capture.json").read_text()
    assert "youngs_modulus" not in stated and "poisson_ratio" not in stated and "damping" not in stated
    truth = json.loads((capture.folder / "truth.json").read_text())
    assert truth["youngs_modulus"] == success.drop.youngs_modulus
    again = capture.folder.parents[1] / "two" / capture.folder.name
    assert sorted(p.name for p in again.iterdir()) == sorted(p.name for p in capture.folder.iterdir())
    for path in capture.folder.iterdir():
        assert path.read_bytes() == (again / path.name).read_bytes(), path.name


@pytest.mark.slow
def test_the_command_makes_captures_finishes_them_and_refuses_others(tmp_path):
    out = tmp_path / "captures"
    arguments = ["captures", "--out", str(out), "--count", "1", "--workers", "1", "--markers", "3", "--no-progress"]
    arguments += [part for setting in SMALL for part in ("--set", setting)]
    runner = CliRunner()
    first = runner.invoke(app, arguments)
    assert first.exit_code == 0, first.output
    assert "1 captures made" in first.output
    assert load_capture(out / "000000").tracks().positions.shape == (4, 3, 3)
    assert "0 captures made, 1 were there" in runner.invoke(app, arguments).output
    other = runner.invoke(app, [*arguments, "--seed", "5"])
    assert isinstance(other.exception, InputError)
    assert "another seed" in str(other.exception)


def test_wrong_options_are_refused(tmp_path):
    with pytest.raises(InputError, match="markers"):
        RingOptions(markers=-1)
    with pytest.raises(InputError, match="marker_noise"):
        RingOptions(marker_noise=0.0)
    with pytest.raises(InputError, match="observed_frames"):
        generate_captures(tmp_path, count=1, config=CONFIG, options=RingOptions(observed_frames=9))
    with pytest.raises(InputError, match="count"):
        generate_captures(tmp_path, count=0, config=CONFIG)
