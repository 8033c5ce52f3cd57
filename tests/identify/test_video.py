"""Points followed in a made video, and outlines, against what was drawn."""

import cv2
import numpy as np
import pytest

from physconvex import InputError
from physconvex.identify import (
    FollowOptions,
    OutlineObservations,
    StackedObservations,
    cast_camera_rays,
    follow,
    follow_from_model,
    seed_points,
)
from physconvex.identify.outlines import outline_of_mask, with_drawn_outlines
from physconvex.io import look_at
from physconvex.mesh import box_mesh

SIZE = np.array([0.3, 0.2, 0.25])
CAMERA = look_at((0.75, -1.1, 0.6), SIZE / 2, width=128, height=96, vertical_field_of_view=0.42)


def box_surface():
    mesh = box_mesh(tuple(SIZE), (6, 4, 5), order=1)
    used, faces = np.unique(mesh.boundary_faces, return_inverse=True)
    return mesh.vertices[used], faces.reshape(-1, 3)


def texture(points):
    """Smooth colours fixed to the body: waves shorter than the box."""
    waves = np.random.default_rng(2).normal(scale=40.0, size=(3, 12, 3))
    phases = np.random.default_rng(3).uniform(0, 6, size=(3, 12))
    return 128 + 18 * np.stack([np.sin(points @ w.T + p).sum(-1) for w, p in zip(waves, phases, strict=True)], axis=-1)


def moving(angle, shift, vertices):
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return (vertices - SIZE / 2) @ turn.T + SIZE / 2 + shift


@pytest.fixture(scope="module")
def film():
    """Surface, motion [T, V, 3], images, masks."""
    vertices, faces = box_surface()
    moved = np.stack([moving(0.03 * t, np.array([0.002, 0, -0.006]) * t, vertices) for t in range(5)])
    images, masks = [], []
    for x in moved:
        hits = cast_camera_rays(CAMERA, x, faces)
        seen = hits.faces >= 0
        image = np.where(seen[..., None], texture(np.nan_to_num(hits.on(vertices, faces))), 255)
        images.append(image.clip(0, 255).astype(np.uint8))
        masks.append(seen)
    return vertices, faces, moved, np.stack(images), np.stack(masks)


def truth_of(seeds):
    return np.stack([moving(0.03 * t, np.array([0.002, 0, -0.006]) * t, seeds.points) for t in range(5)])


def test_seeds_lie_on_the_surface_where_they_are_seen(film):
    vertices, faces, _, images, masks = film
    seeds = seed_points(CAMERA, images[0], vertices, faces, mask=masks[0])
    assert len(seeds.points) > 20
    np.testing.assert_allclose(CAMERA.project(seeds.points)[0], seeds.pixels, atol=1e-6)
    gap = np.minimum(np.abs(seeds.points), np.abs(seeds.points - SIZE)).min(1)
    assert gap.max() < 1e-9


def test_points_are_followed_to_a_fraction_of_a_pixel(film):
    vertices, faces, _, images, masks = film
    seeds = seed_points(CAMERA, images[0], vertices, faces, mask=masks[0])
    found = follow(images, seeds.pixels)
    error = np.linalg.norm(found - CAMERA.project(truth_of(seeds))[0], axis=-1)
    assert np.isfinite(error[-1]).mean() > 0.5
    assert np.nanmedian(error[-1]) < 0.5


def test_from_a_model_that_is_off_points_are_found_where_they_are(film):
    """The model lags by 2 pixels; what is measured lies within half a pixel of the truth, and nearer than before."""
    vertices, faces, moved, images, masks = film
    seeds = seed_points(CAMERA, images[0], vertices, faces, mask=masks[0])
    lag = np.array([0.01, 0, 0.01]) * np.linspace(0, 1, 5)[:, None, None]
    options = FollowOptions(window=9)
    found = follow_from_model(
        images, CAMERA, moved=moved + lag, triangles=faces, predicted=truth_of(seeds) + lag, options=options
    )
    exact = CAMERA.project(truth_of(seeds))[0]
    error = np.linalg.norm(found - exact, axis=-1)[-1]
    assert np.isfinite(error).sum() > 10
    assert np.nanmedian(error) < 0.3
    assert np.median(np.linalg.norm(CAMERA.project(truth_of(seeds) + lag)[0] - exact, axis=-1)[-1]) > 1.5


def test_nothing_to_follow_is_said(film):
    vertices, faces, _, images, _ = film
    with pytest.raises(InputError, match="no point of the object can be followed"):
        seed_points(CAMERA, np.full_like(images[0], 80), vertices, faces)


def test_the_outline_of_a_disk():
    canvas = np.zeros((60, 80), np.uint8)
    cv2.circle(canvas, (40, 30), 20, 1, -1)
    pixels, normals = outline_of_mask(canvas > 0, 50)
    radius = pixels - [40.5, 30.5]
    assert np.abs(np.linalg.norm(radius, axis=1) - 20.3).max() < 0.8
    assert ((radius / np.linalg.norm(radius, axis=1, keepdims=True)) * normals).sum(1).min() > 0.97
    assert len(outline_of_mask(np.zeros((9, 9), bool), 5)[0]) == 0


def test_outline_residuals_vanish_at_the_truth_and_measure_a_shift(film):
    vertices, faces, moved, _, masks = film
    seen = OutlineObservations.of_masks(CAMERA, masks, vertices, faces, sigma=1.0)
    at_truth = seen.residuals(moved)
    assert np.abs(at_truth).mean() < 0.5
    assert abs(at_truth.mean()) < 0.15
    right = CAMERA.rotation[:, 0] * 0.01
    tangents = np.broadcast_to(right, (5, 1, len(vertices), 3))
    residuals, jacobian = seen.linearise(moved, tangents)
    np.testing.assert_array_equal(residuals, at_truth)
    change = seen.residuals(moved + right) - residuals
    depth = CAMERA.project(SIZE / 2)[1]
    expected = CAMERA.fl_x * 0.01 / depth * seen.normals[:, 0]
    # the match may jump along a straight edge, hence the loose single points and the tight mean
    np.testing.assert_allclose(jacobian[:, 0], expected, atol=0.25)
    assert np.median(np.abs(change - expected)) < 0.3
    assert len(seen.point_indices) == len(seen.frames) == len(seen.robust_scales)


def test_an_outline_that_is_drawn_once_serves_for_small_changes(film):
    vertices, faces, moved, _, masks = film
    seen = OutlineObservations.of_masks(CAMERA, masks, vertices, faces, sigma=1.0)
    drawn = with_drawn_outlines(StackedObservations((seen,)), moved)
    np.testing.assert_array_equal(drawn.residuals(moved), seen.residuals(moved))
    shifted = moved + CAMERA.rotation[:, 0] * 0.003
    assert np.median(np.abs(drawn.residuals(shifted) - seen.residuals(shifted))) < 0.02
    again = drawn.parts[0].with_drawn(shifted)
    np.testing.assert_array_equal(again.residuals(shifted), seen.residuals(shifted))
