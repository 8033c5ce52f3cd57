"""How far a surface from pictures may be off: what is unseen, and displacements of one standard deviation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from physconvex.reconstruction import surface_error
from tests.reconstruction.scenes import RADIUS, ball_mesh, views


@pytest.fixture(scope="module")
def ball():
    return ball_mesh(4)


@pytest.fixture(scope="module")
def above():
    """Five views of the ball's upper half alone."""
    return views(10, size=96)[::2]


def test_the_underside_is_unseen_from_above(ball, above):
    all_round, half = surface_error(ball, views(10, size=96)), surface_error(ball, above)
    assert all_round.unseen_share < 0.05 and all_round.views.max() >= 4
    assert 0.15 < half.unseen_share < 0.5
    heights, hidden = ball.vertices[:, 2], half.unseen > 0
    assert heights[hidden].max() < heights[~hidden].mean() and hidden[heights.argmin()]
    assert half.unseen[heights.argmin()] > 1.5 * half.unseen[hidden].min()  # it grows with the distance
    assert half.common == pytest.approx(np.sqrt(2) * all_round.common, rel=0.01)  # of half the views
    assert half.local == pytest.approx(all_round.local, rel=0.01)  # their cubes differ a little


def lid_painted(seen, value):
    """The picture with all of the ball above half its radius in one grey."""
    camera = seen.camera
    pixels = np.stack(np.meshgrid(np.arange(camera.w), np.arange(camera.h)), axis=-1).reshape(-1, 2) + 0.5
    origin, directions = camera.rays(pixels)
    along = directions @ origin
    under = np.maximum(along**2 - (origin @ origin - RADIUS**2), 0)
    heights = (origin + (-along - np.sqrt(under))[:, None] * directions)[:, 2]
    lid = torch.as_tensor((under > 0) & (heights > 0.5 * RADIUS)).reshape(camera.h, camera.w, 1)
    return torch.where(lid, torch.full_like(seen.image, value), seen.image)


def test_a_surface_that_no_two_pictures_show_alike_may_be_hollow(ball):
    """The pictures of a mug show its inside where its silhouettes show a lid."""
    seen = views(10, size=96)
    assert surface_error(ball, seen).contested_share == 0
    upper = [replace(one, image=lid_painted(one, 0.9 * (k % 4 > 1))) for k, one in enumerate(seen)]
    error = surface_error(ball, upper)
    heights, wide = ball.vertices[:, 2], error.unseen > 0.5 * RADIUS
    assert error.contested_share == pytest.approx(0.25, abs=0.1) and heights[wide].min() > 0.3 * RADIUS
    assert error.unseen[wide] == pytest.approx(RADIUS, rel=0.05)  # half of the way through


def test_displacements_have_the_stated_deviations(ball, above):
    error = surface_error(ball, above)
    (one, common), (two, unseen), *local = error.displacements(
        ball.vertices, draws=200, generator=np.random.default_rng(0)
    )
    assert one == two == 1.0 and np.array_equal(unseen, error.unseen) and np.ptp(common) == 0
    assert sum(weight for weight, _ in local) == pytest.approx(1.0)
    drawn = np.array([by for _, by in local])
    assert np.sqrt((drawn**2).mean(axis=0)).mean() == pytest.approx(error.local, rel=0.05)
    first, others = drawn[:, 0], np.linalg.norm(ball.vertices - ball.vertices[0], axis=1)
    near, far = np.abs(others - error.length) < 0.4 * error.length, others > RADIUS
    correlation = (first[:, None] * drawn).mean(axis=0) / error.local**2
    assert correlation[near].mean() == pytest.approx(np.exp(-0.5), abs=0.15)
    assert abs(correlation[far].mean()) < 0.1
    seen = replace(error, unseen=np.zeros(len(error.views)))
    assert len(seen.displacements(ball.vertices, draws=3, generator=np.random.default_rng(0))) == 4
