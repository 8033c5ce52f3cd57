"""The renderer against `Camera`: places, masks, light, shadow; and that equal input gives equal bytes."""

import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from data_gen import Backdrop, DrawnSurface, Lighting, Renderer
from data_gen.surface import corner_normals
from physconvex import InputError
from physconvex.io import Camera, look_at

GREY = Backdrop(np.full((8, 8, 3), 160, np.uint8), np.full((8, 8, 3), 90, np.uint8))
OVERHEAD = Lighting((0.0, 0.0, 1.0), shadow_softness=0.0)


@pytest.fixture(scope="module")
def renderer():
    renderer = Renderer(96, 64, supersampling=2)
    yield renderer
    renderer.close()


def ball(radius: float, color=(200, 60, 40)) -> DrawnSurface:
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    colors = np.tile(np.array(color, np.uint8), (len(sphere.vertices), 1))
    return DrawnSurface(np.asarray(sphere.vertices), np.asarray(sphere.faces), colors=colors)


def camera(**changes) -> Camera:
    base = look_at((0.4, -4, 1.5), (0, 0, 0.8), width=96, height=64, vertical_field_of_view=0.7)
    return Camera.from_json(base.to_json() | changes)


def centroid(cover: np.ndarray) -> np.ndarray:
    rows, columns = np.mgrid[: cover.shape[0], : cover.shape[1]] + 0.5
    return np.array([(columns * cover).sum(), (rows * cover).sum()]) / cover.sum()


@pytest.mark.parametrize("intrinsics", [{}, {"cx": 57.0, "cy": 22.5}, {"fl_x": 60.0, "fl_y": 95.0}])
def test_small_ball_is_drawn_where_the_camera_projects_it(renderer, intrinsics):
    surface, view = ball(0.06), camera(**intrinsics)
    renderer.set_surface(surface)
    renderer.set_view(view, OVERHEAD, GREY)
    for place in ([0.0, 0.0, 0.8], [0.5, 0.3, 0.5], [-0.6, -0.4, 1.2]):
        cover = renderer.frame(surface.vertices + place)[1]
        # The silhouette of a ball of angular radius a, b off the axis, is off by about a² tan b: < 0.01 pixels here.
        # What remains is the half-sample error of 2×2 super-sampling.
        np.testing.assert_allclose(centroid(cover), view.project(np.array(place))[0], atol=0.2)


def test_mask_has_the_ball_s_area(renderer):
    surface, view = ball(0.4), camera()
    renderer.set_surface(surface)
    renderer.set_view(view, OVERHEAD, GREY)
    place = np.array([0.0, 0.0, 0.8])
    cover = renderer.frame(surface.vertices + place)[1]
    depth = view.project(place)[1]
    radius = view.fl_y * 0.4 / np.sqrt(depth**2 - 0.4**2)  # silhouette cone of a ball
    assert cover.sum() == pytest.approx(np.pi * radius**2, rel=0.03)
    assert cover.max() == 1.0 and cover[0, 0] == 0.0


def test_shadow_lies_under_the_object_and_only_darkens(renderer):
    surface, view = ball(0.25), camera()
    renderer.set_surface(surface)
    renderer.set_view(view, OVERHEAD, GREY)
    image, cover = renderer.frame(surface.vertices + np.array([0, 0, 1.3]))
    dark = (renderer.plate - image).sum(axis=-1) * (cover == 0)
    assert dark.min() > -1e-6 and dark.max() > 0.3
    np.testing.assert_allclose(centroid(np.maximum(dark, 0)), view.project(np.zeros(3))[0], atol=0.7)
    lower = renderer.frame(surface.vertices + np.array([0, 0, 0.9]))[0]
    assert np.abs(lower - image).max() > 0.1


def test_shadow_moves_away_from_a_slanted_light(renderer):
    surface, view = ball(0.25), camera()
    renderer.set_surface(surface)
    renderer.set_view(view, Lighting((0.6, 0.0, 0.8), shadow_softness=0.0), GREY)
    image, cover = renderer.frame(surface.vertices + np.array([0, 0, 0.8]))
    dark = np.maximum((renderer.plate - image).sum(axis=-1) * (cover == 0), 0)
    # The centre's shadow falls at −z·(lx, ly)/lz.
    np.testing.assert_allclose(centroid(dark), view.project(np.array([-0.6, 0, 0]))[0], atol=1.0)


def test_light_side_is_brighter_and_colours_survive(renderer):
    surface, view = ball(0.4), camera()
    renderer.set_surface(surface)
    renderer.set_view(view, Lighting((0.8, -0.36, 0.48), fill=0.1), GREY)
    image, cover = renderer.frame(surface.vertices + np.array([0, 0, 0.8]))
    red = np.where(cover == 1, image[..., 0], np.nan)
    middle = round(view.project(np.array([0, 0, 0.8]))[0][0])
    assert np.nanmean(red[:, middle:]) > 1.3 * np.nanmean(red[:, :middle])
    inside = image[cover == 1]
    assert (inside[:, 0] > inside[:, 2]).mean() > 0.95
    assert 0.15 < inside.mean() < 0.8


def test_texture_is_upright(renderer):
    # A square facing the camera; the texture's first row (green) is at v = 1.
    vertices = np.array([[-0.5, 0, 0.4], [0.5, 0, 0.4], [0.5, 0, 1.4], [-0.5, 0, 1.4]])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    texture = np.zeros((16, 16, 3), np.uint8)
    texture[:8, :, 1], texture[8:, :, 0] = 255, 255
    renderer.set_surface(DrawnSurface(vertices, np.array([[0, 1, 2], [0, 2, 3]]), uv=uv, texture=texture))
    view = camera()
    renderer.set_view(view, Lighting((0.0, -0.6, 0.8), specular=0.0), GREY)
    image = renderer.frame(vertices)[0]
    for height, channel in ((1.25, 1), (0.55, 0)):
        column, row = view.project(np.array([0, 0, height]))[0].astype(int)
        assert image[row, column].argmax() == channel


def test_equal_input_gives_equal_bytes_also_after_other_scenes(renderer):
    surface, view = ball(0.3), camera()

    def picture() -> bytes:
        renderer.set_surface(surface)
        renderer.set_view(view, Lighting((0.3, -0.2, 0.93)), GREY)
        image, cover = renderer.frame(surface.vertices + np.array([0.1, 0, 0.9]))
        return image.tobytes() + cover.tobytes()

    first = picture()
    renderer.set_surface(ball(0.1))
    renderer.set_view(camera(cx=40.0), OVERHEAD, GREY)
    renderer.frame(ball(0.1).vertices + np.array([0, 0, 1]))
    assert picture() == first


def test_normals_are_smooth_on_a_ball_and_broken_on_a_box():
    sphere = trimesh.creation.icosphere(subdivisions=3)
    normals = corner_normals(sphere.vertices, sphere.faces).at(sphere.vertices[sphere.faces])
    np.testing.assert_allclose(normals, sphere.vertices[sphere.faces].reshape(-1, 3), atol=0.02)
    box = trimesh.creation.box()
    normals = corner_normals(box.vertices, box.faces).at(box.vertices[box.faces])
    np.testing.assert_allclose(normals, np.repeat(box.face_normals, 3, axis=0), atol=1e-12)


def test_wrong_use_is_refused(renderer):
    renderer.set_surface(ball(0.1))
    with pytest.raises(InputError, match="32×32"):
        renderer.set_view(camera().resized(32, 32), OVERHEAD, GREY)
    with pytest.raises(InputError, match="k1"):
        renderer.set_view(camera(k1=0.1), OVERHEAD, GREY)
    with pytest.raises(InputError, match="colors"):
        DrawnSurface(np.eye(3), np.array([[0, 1, 2]]))


@pytest.mark.skipif(sys.platform != "linux", reason="EGL's vendor files are a Linux matter")
@pytest.mark.slow
def test_missing_opengl_is_named_with_its_remedy():
    code = "from data_gen.render import Renderer; Renderer(16, 16)"
    hidden = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | hidden, capture_output=True, text=True, check=False
    )
    if done.returncode == 0:
        pytest.skip("OSMesa or another OpenGL is there")
    assert "RenderError" in done.stderr and "libegl1" in done.stderr and "libgl1-mesa-dri" in done.stderr
    assert "bad X server" not in done.stderr
