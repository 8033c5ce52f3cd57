"""Films: the field stays in view from all round, frames are pictures of the fields given."""

import itertools

import numpy as np
import pytest
import torch

from physconvex.convex import advect, affine_map
from physconvex.errors import InputError
from physconvex.render import film, orbit
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
