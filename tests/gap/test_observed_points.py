"""What is compared: markers and pixels; effects of cameras as motions that look the same to them."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex import InputError
from physconvex.gap import DEFAULT_EFFECTS, EffectModel, PointMotion
from physconvex.gap.base.observed_points import components, in_metres, lost_points, observations_of, widened
from physconvex.identify import MarkerObservations, PixelObservations
from physconvex.io import Camera, Capture


def effect(name):
    return next(e for e in DEFAULT_EFFECTS if e.name == name)


@pytest.fixture
def camera():
    """Looks along −y from 3 m away, z up."""
    pose = np.eye(4)
    pose[:3, :3] = np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]]).T
    pose[:3, 3] = [0.0, 3.0, 0.5]
    return Camera.from_json(
        {"name": "front", "w": 400, "h": 300, "fl_x": 500.0, "fl_y": 500.0, "cx": 200.0, "cy": 150.0,
         "transform_matrix": pose.tolist()}
    )  # fmt: skip


@pytest.fixture
def motion(camera):
    times = np.arange(6) / 30.0
    rest = np.random.default_rng(0).uniform(-0.3, 0.3, (7, 3)) + np.array([0, 0, 0.5])
    velocity = np.array([0.5, 0.0, -0.4])
    positions = rest + velocity * times[:, None, None]
    return PointMotion(rest, times, positions, np.broadcast_to(velocity, positions.shape).copy(), camera)


def pixels_of(camera, positions):
    pixels, _ = camera.project(positions.reshape(-1, 3))
    return pixels.reshape(*positions.shape[:2], 2)


def test_camera_sees_the_points(camera, motion):
    assert np.isfinite(pixels_of(camera, motion.positions)).all()


def test_focal_length_is_what_a_longer_lens_sees(camera, motion):
    longer = replace(camera, fl_x=1.02 * camera.fl_x, fl_y=1.02 * camera.fl_y)
    seen = effect("focal_length").observe(motion, np.array([0.02]))
    np.testing.assert_allclose(pixels_of(camera, seen), pixels_of(longer, motion.positions), atol=1e-8)


def test_distortion_is_what_a_bent_lens_sees(camera, motion):
    bent = replace(camera, k1=0.1)
    seen = effect("lens_distortion").observe(motion, np.array([0.1]))
    np.testing.assert_allclose(pixels_of(camera, seen), pixels_of(bent, motion.positions), atol=1e-8)


def test_rolling_shutter_moves_with_the_row(camera, motion):
    seen = effect("rolling_shutter").observe(motion, np.array([0.01]))
    rows = pixels_of(camera, motion.positions)[2, :, 1] / camera.h - 0.5
    np.testing.assert_allclose(seen[2] - motion.positions[2], 0.01 * rows[:, None] * motion.velocities[2], atol=1e-9)


def test_pose_turns_about_the_camera(camera, motion):
    seen = effect("camera_pose").observe(motion, np.array([0, 0, 1.0, 0, 0, 0]))
    distance = np.linalg.norm(motion.positions - camera.position, axis=-1)
    np.testing.assert_allclose(np.linalg.norm(seen - camera.position, axis=-1), distance, atol=1e-12)


def test_lengths_and_widening(camera, motion):
    pixels = pixels_of(camera, motion.positions)
    pixels[3, 1] = np.nan
    filmed = PixelObservations(camera, motion.rest, pixels, np.full(pixels.shape[:2], 2.0))
    depth = np.abs((motion.positions - camera.position) @ camera.rotation)[..., 2]
    expected = 2.0 * depth[filmed.frames, filmed.point_indices] / 500.0
    np.testing.assert_allclose(in_metres(filmed, motion), expected)
    assert components(filmed) == 2
    variance = np.where(filmed.frames == 2, 9.0, 1.0)
    wide = widened(filmed, variance)
    moved = motion.positions + 0.01
    ratio = filmed.residuals(moved) / wide.residuals(moved)
    np.testing.assert_allclose(ratio, np.sqrt(variance))


def test_points_that_a_video_loses_are_told(camera):
    rest = np.random.default_rng(4).uniform(-0.1, 0.1, (12, 3))
    pixels = np.repeat(pixels_of(camera, rest[None]), 8, axis=0)
    sigma = np.ones(pixels.shape[:2])
    assert lost_points(PixelObservations(camera, rest, pixels, sigma)) == ()
    pixels[5:, 3:] = np.nan
    (caveat,) = lost_points(PixelObservations(camera, rest, pixels, sigma))
    assert "12 points" in caveat and "3 are left in frame 5 of 8" in caveat
    assert lost_points(MarkerObservations(rest, np.repeat(rest[None], 8, axis=0), sigma)) == ()


def test_markers_are_in_metres_already(motion):
    markers = MarkerObservations(motion.rest, motion.positions, np.full(motion.positions.shape[:2], 1e-3))
    assert components(markers) == 3
    np.testing.assert_allclose(in_metres(markers, motion), 1e-3)


@pytest.mark.wrong_types
def test_nothing_seen(tmp_path):
    with pytest.raises(InputError, match=r"no tracks\.npz and no cameras"):
        observations_of(Capture(tmp_path, 24.0, 12, 8), None)  # type: ignore[arg-type]


@pytest.mark.wrong_types  # no twin is needed for what is observed of a motion
@pytest.mark.parametrize("name", ["focal_length", "time_offset"])
def test_errors_of_a_camera_move_points_from_its_first_image_on(camera, motion, name):
    """Points are put on the surface where the first image, with the error in it, shows them."""
    true, late = (camera, 0.02) if name == "time_offset" else (replace(camera, fl_x=480.0, fl_y=480.0), 0.0)
    dose = late or 480.0 / 500.0 - 1
    happened = motion.positions + late * motion.velocities
    seen = pixels_of(true, happened)
    local = (happened[0] - camera.position) @ camera.rotation
    local[:, :2] *= true.fl_x / camera.fl_x  # where rays of the stated camera through the first image's pixels go
    placed = local @ camera.rotation.T + camera.position
    taken = replace(motion, rest=placed, positions=motion.positions - motion.positions[0] + placed)
    model = EffectModel(None, (), placed, len(seen), None, (effect(name),), camera)
    np.testing.assert_allclose(pixels_of(camera, model.observed(taken, np.array([dose]))), seen, atol=1e-6)
    off = pixels_of(camera, model.observed(taken, np.zeros(1))) - seen
    assert np.abs(off[0]).max() < 1e-9 and (np.abs(off[-1]).max() > 0.5 or name == "time_offset")
