"""Projection against closed forms, round trips, and refusals."""

import numpy as np
import pytest

from physconvex import InputError
from physconvex.io import Camera, look_at


def test_point_seen_at_the_closed_form_pixel():
    # Identity pose: looking along −z from the origin. u = fl_x X/(−Z) + cx, v = cy − fl_y Y/(−Z).
    camera = Camera("c", 200, 100, 150.0, 120.0, 90.0, 60.0, np.eye(4))
    pixels, depth = camera.project(np.array([0.5, 0.25, -2.0]))
    np.testing.assert_allclose(pixels, [150 * 0.25 + 90, 60 - 120 * 0.125])
    assert depth == 2.0


def test_look_at_centres_the_target_and_keeps_up_upward():
    camera = look_at((0, -4, 1), (0.2, 0, 1), width=64, height=48, vertical_field_of_view=np.deg2rad(40))
    pixels, depth = camera.project(np.array([[0.2, 0, 1.0], [0.2, 0, 1.1], [0.3, 0, 1.0]]))
    np.testing.assert_allclose(pixels[0], [32, 24], atol=1e-12)
    assert depth[0] == pytest.approx(np.hypot(4, 0.2))
    assert pixels[1, 1] < 24 and pixels[1, 0] == pytest.approx(32)
    assert pixels[2, 0] > 32
    # A point half the field of view above the centre falls on the upper image edge.
    edge = np.array([0.2, 0, 1.0 + depth[0] * np.tan(np.deg2rad(20))])
    assert camera.project(edge)[0][1] == pytest.approx(0, abs=1e-9)


def test_points_in_the_axes_of_a_camera():
    camera = look_at((0, -4, 1), (0, 0, 1), width=64, height=48, vertical_field_of_view=0.7)
    np.testing.assert_allclose(camera.local(np.array([0.5, -1.0, 1.2])), [0.5, 0.2, -3.0], atol=1e-12)
    points = np.random.default_rng(0).normal(size=(2, 5, 3))
    np.testing.assert_allclose(camera.world(camera.local(points)), points, atol=1e-12)
    np.testing.assert_allclose(-camera.local(points)[..., 2], camera.project(points)[1])


@pytest.mark.parametrize("distortion", [(0.0, 0.0), (-0.12, 0.03)])
def test_rays_invert_project(distortion):
    base = look_at((1, -3, 2), (0, 0, 0.5), width=32, height=24, vertical_field_of_view=0.8).to_json()
    camera = Camera.from_json(base | {"k1": distortion[0], "k2": distortion[1]})
    origin, directions = camera.rays()
    assert directions.shape == (24, 32, 3)
    pixels, depth = camera.project(origin + 3.0 * directions)
    columns, rows = np.meshgrid(np.arange(32) + 0.5, np.arange(24) + 0.5)
    np.testing.assert_allclose(pixels, np.stack([columns, rows], -1), atol=1e-7)
    assert (depth > 0).all()


def test_behind_the_camera_is_nan():
    camera = Camera("c", 10, 10, 10, 10, 5, 5, np.eye(4))
    pixels, depth = camera.project(np.array([0, 0, 1.0]))
    assert np.isnan(pixels).all() and depth < 0


def test_json_round_trip_and_resize():
    camera = look_at((1, -3, 2), (0, 0, 0), width=32, height=24, vertical_field_of_view=0.8, name="left")
    entry = camera.to_json()
    again = Camera.from_json(entry)
    assert again.to_json() == entry and "k1" not in entry and again.name == "left"
    point = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(again.resized(64, 48).project(point)[0], 2 * camera.project(point)[0])


@pytest.mark.parametrize(
    "change, word",
    [
        ({"transform_matrix": np.diag([2.0, 2, 2, 1]).tolist()}, "rotation"),
        ({"transform_matrix": [[1, 2]]}, "4×4"),
        ({"w": 0}, "positive"),
        ({"fl_x": "wide"}, "wide"),
    ],
)
def test_bad_cameras_are_refused(change, word):
    entry = Camera("c", 10, 10, 10, 10, 5, 5, np.eye(4)).to_json()
    with pytest.raises(InputError, match=word):
        Camera.from_json(entry | change)


def test_missing_field_is_named():
    with pytest.raises(InputError, match="fl_y"):
        Camera.from_json({"name": "c", "w": 1, "h": 1, "fl_x": 1, "cx": 0, "cy": 0, "transform_matrix": []})


def test_degenerate_look_at_is_refused():
    with pytest.raises(InputError, match="up"):
        look_at((0, 0, 1), (0, 0, 0), width=8, height=8, vertical_field_of_view=1.0)
