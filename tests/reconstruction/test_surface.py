"""The body's closed surface: against a ball and a body with a thin limb, from pictures alone."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree

from physconvex.convex import ConvexField, coefficients_of_colour
from physconvex.reconstruction import closed_surface, textured, visual_hull
from physconvex.reconstruction.carving import hull_distance
from tests.reconstruction.scenes import RADIUS, ball_mesh, speckled_ball, views


@pytest.fixture(scope="module")
def many():
    return views(10, size=128, field=speckled_ball())


@pytest.fixture(scope="module")
def surface(many):
    return closed_surface(speckled_ball(), many)


def test_the_hull_s_distance_is_that_of_a_ball(many):
    places = np.random.default_rng(0).normal(size=(200, 3))
    factors = np.linspace(0.5, 1.4, 200)
    places *= factors[:, None] * RADIUS / np.linalg.norm(places, axis=1, keepdims=True)
    larger = (factors - 1) - hull_distance(many, places) / RADIUS
    assert larger.min() > -0.01  # the hull holds the ball
    assert np.median(larger[np.abs(factors - 1) < 0.1]) < 0.01 and larger.max() < 0.08  # between the silhouettes


def test_a_ball_from_pictures_is_closed_and_nearer_than_its_visual_hull(surface, many):
    exact = 4 / 3 * np.pi * RADIUS**3
    assert surface.is_watertight and surface.body_count == 1
    assert surface.volume == pytest.approx(exact, rel=0.01)

    def error(mesh: trimesh.Trimesh) -> float:
        return float(np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS).mean())

    assert error(surface) < 0.002 * 2 * RADIUS
    assert error(surface) < 0.5 * error(visual_hull(many))


def test_three_views_give_a_closed_surface_too():
    field = speckled_ball()
    surface = closed_surface(field, views(3, size=64, field=field))
    assert surface.is_watertight and 0.5 < surface.volume / (4 / 3 * np.pi * RADIUS**3) < 3


def test_the_surface_has_the_colours_of_the_body(surface):
    seen = surface.visual.vertex_colors[:, :3] / 255
    ball = ball_mesh()
    nearest = cKDTree(ball.triangles_center).query(surface.vertices)[1]
    painted = np.random.default_rng(0).uniform(0.1, 0.9, (len(ball.faces), 3))[nearest]
    assert np.corrcoef(seen.ravel(), painted.ravel())[0, 1] > 0.7
    assert np.abs(seen.mean(axis=0) - painted.mean(axis=0)).max() < 0.03


def test_a_texture_is_finer_than_colours_of_vertices_and_leaves_the_surface_closed(surface, many):
    found = textured(surface, many, size=512)
    assert found.visual.material.baseColorTexture.size == (512, 512)
    places, faces = trimesh.sample.sample_surface(found, 4000, seed=0)
    weights = trimesh.triangles.points_to_barycentric(found.vertices[found.faces[faces]], places)
    of_texture = trimesh.visual.color.uv_to_color(
        np.einsum("tk,tki->ti", weights, found.visual.uv[found.faces[faces]]), found.visual.material.baseColorTexture
    )[:, :3] / 255  # fmt: skip
    source = cKDTree(surface.vertices).query(found.vertices)[1]
    colours = surface.visual.vertex_colors[:, :3][source] / 255
    of_vertices = np.einsum("tk,tki->ti", weights, colours[found.faces[faces]])
    ball = ball_mesh()
    nearest = cKDTree(ball.triangles_center).query(places)[1]
    painted = np.random.default_rng(0).uniform(0.1, 0.9, (len(ball.faces), 3))[nearest]
    errors = [float(np.abs(colours - painted).mean()) for colours in (of_texture, of_vertices)]
    assert errors[0] < 0.9 * errors[1] and errors[0] < 0.08
    assert np.array_equal(found.vertices, surface.vertices[source])
    found.merge_vertices(merge_tex=True, merge_norm=True)
    assert found.is_watertight and found.volume == pytest.approx(surface.volume)


def test_a_limb_of_two_pixels_stays_on_the_body():
    """A ball with a thin rod, which the fused depths lose: the silhouettes keep it, in one piece."""
    ball, rod = ball_mesh(), trimesh.creation.cylinder(0.0025, 0.04, sections=8)
    rod.apply_translation([0, 0, RADIUS + 0.018])
    prisms = [np.concatenate([ball.triangles, 0.8 * ball.triangles], axis=1)]
    axis = np.repeat((rod.triangles_center * [0, 0, 1])[:, None], 3, axis=1)
    prisms.append(np.concatenate([rod.triangles, 0.5 * rod.triangles + 0.5 * axis], axis=1))
    points = torch.as_tensor(np.concatenate(prisms), dtype=torch.float32)
    ones, rng = torch.ones(len(points)), np.random.default_rng(0)
    colours = torch.as_tensor(rng.uniform(0.1, 0.9, (len(points), 3)), dtype=torch.float32)
    field = ConvexField(points, 4e4 * ones, ones, ones, coefficients_of_colour(colours))
    surface = closed_surface(field, views(8, size=128, field=field))
    assert surface.body_count == 1 and surface.is_watertight
    assert surface.bounds[1, 2] > RADIUS + 0.034  # of 0.038
