"""Residuals are whitened differences; their derivatives are those of central differences."""

import numpy as np
import pytest

from physconvex import InputError
from physconvex.identify import MarkerObservations, PixelObservations, StackedObservations, camera_jacobian
from physconvex.io import Camera, look_at

RNG = np.random.default_rng(3)
POINTS = RNG.uniform(-0.3, 0.3, size=(5, 3))


def camera(**distortion) -> Camera:
    plain = look_at((1.0, -3.0, 0.7), (0, 0, 0), width=64, height=48, vertical_field_of_view=0.6)
    return Camera(**{**vars(plain), "fl_x": 1.1 * plain.fl_x, **distortion})


def test_camera_jacobian_against_differences():
    lens = camera(k1=-0.3, k2=0.1)
    step = 1e-6
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        slope = (lens.project(POINTS + shift)[0] - lens.project(POINTS - shift)[0]) / (2 * step)
        np.testing.assert_allclose(camera_jacobian(lens, POINTS)[:, :, axis], slope, rtol=1e-6, atol=1e-5)


def markers() -> MarkerObservations:
    seen = POINTS + RNG.normal(scale=0.01, size=(4, 5, 3))
    seen[2, 1] = np.nan
    return MarkerObservations(POINTS, seen, np.full((4, 5), 0.02))


def pixels() -> PixelObservations:
    lens = camera(k1=-0.3)
    seen = np.broadcast_to(lens.project(POINTS)[0], (4, 5, 2)) + RNG.normal(size=(4, 5, 2))
    seen[0, 4] = np.nan
    return PixelObservations(lens, POINTS, seen, np.full((4, 5), 0.5))


def test_marker_residuals_know_their_frame_point_and_axis():
    seen = markers()
    moved = np.broadcast_to(POINTS, (4, 5, 3)).copy()
    moved[3, 4, 1] += 0.04
    change = seen.residuals(moved) - seen.residuals(np.broadcast_to(POINTS, (4, 5, 3)))
    (where,) = np.flatnonzero(np.abs(change) > 1e-9)
    assert (seen.frames[where], seen.point_indices[where], seen.axes[where]) == (3, 4, 1)
    assert change[where] == pytest.approx(2.0)
    assert len(change) == 3 * (20 - 1)


@pytest.mark.parametrize("seen", [markers(), pixels(), StackedObservations.of([markers(), pixels()])])
def test_derivatives_against_differences(seen):
    count = len(seen.points)
    positions = np.tile(POINTS, (4, count // 5, 1)) + RNG.normal(scale=0.02, size=(4, count, 3))
    tangents = RNG.normal(size=(4, 2, count, 3))
    residuals, jacobian = seen.linearise(positions, tangents)
    np.testing.assert_array_equal(residuals, seen.residuals(positions))
    for k in range(2):
        step = 1e-7
        up, down = (seen.residuals(positions + sign * step * tangents[:, k]) for sign in (1, -1))
        np.testing.assert_allclose(jacobian[:, k], (up - down) / (2 * step), rtol=1e-5, atol=1e-3)


def test_a_stack_counts_points_through():
    stack = StackedObservations.of([StackedObservations.of([markers()]), pixels()])
    assert len(stack.parts) == 2 and len(stack.points) == 10
    assert stack.point_indices[stack.residual_slices[1]].min() == 5
    assert len(stack.frames) == len(stack.robust_scales) == 3 * 19 + 2 * 19


def test_nothing_seen_is_refused():
    with pytest.raises(InputError, match="none is seen"):
        MarkerObservations(POINTS, np.full((4, 5, 3), np.nan), np.ones((4, 5)))


@pytest.mark.wrong_types
def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="expected \\[P, 3\\]"):
        MarkerObservations(POINTS, np.zeros((4, 4, 3)), np.ones((4, 5)))
