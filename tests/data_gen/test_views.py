"""Views of a moving body: the whole path is in the picture, and the mask is the projection of its surface."""

import cv2
import numpy as np
import pytest

from data_gen import Renderer, draw_drop, draw_look, load_config, random_stream
from data_gen.scene import surface_of
from physconvex.io import Camera

CONFIG = load_config(overrides=["video={width: 64, height: 48}"])


@pytest.fixture(scope="module")
def renderer():
    renderer = Renderer(64, 48, supersampling=4)
    yield renderer
    renderer.close()


def silhouette(camera: Camera, points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Share of each pixel that the surface's projection covers, from triangles filled at eight times the resolution."""
    pixels, depth = camera.resized(8 * camera.w, 8 * camera.h).project(points)
    assert (depth > 0).all()
    canvas = np.zeros((8 * camera.h, 8 * camera.w), np.uint8)
    for triangle in np.rint(pixels - 0.5).astype(np.int32)[faces]:
        cv2.fillConvexPoly(canvas, triangle, 1)
    return canvas.reshape(camera.h, 8, camera.w, 8).mean(axis=(1, 3))


@pytest.mark.parametrize("simulation", [0, 2])
def test_path_is_in_view_and_masks_are_projections(renderer, simulation):
    rng = random_stream(5, simulation)
    drop = draw_drop(CONFIG, 5, simulation, 0)
    start = drop.placed(drop.body.vertices)
    shifts = np.array([[0.0, 0, 0], [0.1, 0.05, -0.4], [0.2, 0.1, -1.0]]) * start[:, 2].min()
    path = start + shifts[:, None]
    look = draw_look(CONFIG, rng, path, name="front")
    renderer.set_surface(surface_of(drop, rng))
    renderer.set_view(look.camera, look.lighting, look.backdrop)
    for points in path:
        pixels, _ = look.camera.project(points)
        assert (pixels >= 0).all() and (pixels <= [64, 48]).all()
        _, cover = renderer.frame(points)
        drawn = silhouette(look.camera, points, drop.body.faces)
        assert np.minimum(cover, drawn).sum() / np.maximum(cover, drawn).sum() > 0.93
        assert np.abs(cover - drawn).mean() < 0.01
