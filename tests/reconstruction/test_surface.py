"""The body's closed surface: against a ball and a body with a thin limb, from pictures alone."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from physconvex.mesh import surface_distance
from physconvex.reconstruction import closed_surface, visual_hull
from physconvex.reconstruction.carving import hull_distance
from tests.reconstruction.scenes import RADIUS, ring, striped_ball, views


@pytest.fixture(scope="module")
def many():
    return views(10, size=128)


@pytest.fixture(scope="module")
def surface(many):
    return closed_surface(striped_ball(), many)


def test_the_hull_s_distance_is_that_of_a_ball(many):
    places = np.random.default_rng(0).normal(size=(200, 3))
    places *= np.linspace(0.5, 1.4, 200)[:, None] * RADIUS / np.linalg.norm(places, axis=1, keepdims=True)
    error = hull_distance(many, places) - (np.linalg.norm(places, axis=1) - RADIUS)
    # ten silhouettes: the hull is a little larger than the ball, nowhere smaller by more than part of a pixel
    assert np.abs(error).max() < 0.12 * RADIUS and error.max() < 0.01 * RADIUS


def test_a_ball_from_pictures_is_closed_and_nearer_than_its_visual_hull(surface, many):
    exact = 4 / 3 * np.pi * RADIUS**3
    assert surface.is_watertight and surface.body_count == 1
    assert surface.volume == pytest.approx(exact, rel=0.03)

    def error(mesh: trimesh.Trimesh) -> float:
        return float(np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS).mean())

    assert error(surface) < 0.006 * 2 * RADIUS
    assert error(surface) < 0.8 * error(visual_hull(many))


def test_the_surface_has_the_colours_of_the_body(surface):
    colours = surface.visual.vertex_colors[:, :3] / 255
    bands = 120 * surface.vertices[:, 2]
    clear = np.abs(np.sin(bands)) > 0.7
    orange = np.linalg.norm(colours - [0.9, 0.5, 0.2], axis=1) < np.linalg.norm(colours - [0.2, 0.4, 0.7], axis=1)
    assert (orange == (np.sin(bands) > 0))[clear].mean() > 0.95
