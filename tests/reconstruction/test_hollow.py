"""Hollows that no silhouette shows: a cup whose wall is found by the colours of its inside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from physconvex.reconstruction import find_hollow
from tests.reconstruction.scenes import RADIUS, WALL, cup, painted, upright, views


@pytest.fixture(scope="module")
def filled():
    return upright(RADIUS, -RADIUS, RADIUS)


def test_the_wall_of_a_cup_is_as_thick_as_the_pictures_of_its_inside_agree(filled):
    hollow = find_hollow(filled, views(12, size=128, field=painted(cup())))
    assert hollow is not None
    assert hollow.thickness == pytest.approx(WALL, rel=0.15)
    assert hollow.surface.is_watertight and hollow.surface.body_count == 1
    assert hollow.surface.volume == pytest.approx(cup().volume, rel=0.12)
    assert hollow.share == pytest.approx(1 - hollow.surface.volume / filled.volume)
    away = cKDTree(filled.vertices).query(hollow.surface.vertices)[0]
    assert (away < 1e-7).sum() > 0.7 * len(filled.vertices)  # the outer surface keeps its place


def test_a_painted_solid_has_no_hollow(filled):
    assert find_hollow(filled, views(12, size=128, field=painted(filled))) is None


def test_a_lid_that_shines_is_no_hollow(filled):
    """Its colours differ from picture to picture, and no wall explains them."""
    seen, draws = views(12, size=128, field=painted(filled)), np.random.default_rng(0)
    shining = []
    for one in seen:
        camera = one.camera
        pixels = np.stack(np.meshgrid(np.arange(camera.w), np.arange(camera.h)), axis=-1).reshape(-1, 2) + 0.5
        origin, directions = camera.rays(pixels)
        at = origin + ((RADIUS - origin[2]) / directions[:, 2])[:, None] * directions
        lid = (np.hypot(at[:, 0], at[:, 1]) < RADIUS) & (origin[2] > RADIUS)
        glare = torch.as_tensor(draws.uniform(0, 1, 3), dtype=torch.float32)
        where = torch.as_tensor(lid.reshape(camera.h, camera.w, 1))
        shining.append(replace(one, image=torch.where(where, glare.expand_as(one.image), one.image)))
    assert find_hollow(filled, shining) is None


def test_a_body_that_shines_all_over_is_no_hollow(filled):
    seen, draws = views(12, size=128, field=painted(filled)), np.random.default_rng(0)
    shining = [replace(one, image=torch.full_like(one.image, draws.uniform())) for one in seen]
    assert find_hollow(filled, shining) is None
