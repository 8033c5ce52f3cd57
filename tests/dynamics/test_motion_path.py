"""Motion with a given velocity."""

import numpy as np
import pytest

from physconvex import InputError
from physconvex.dynamics import Plane, Sphere
from physconvex.dynamics.motion_path import MotionPath


def test_constant_velocity_and_its_function_come_equally_far():
    steady = MotionPath((1.0, -2.0, 0.5))
    same = MotionPath(lambda t: (1.0, -2.0, 0.5))
    for time in (0.3, 0.0, 0.1, 1.7):
        np.testing.assert_allclose(same.displacement(time), steady.displacement(time), atol=1e-14)


def test_displacement_is_the_integral_in_any_order_of_asking():
    path = MotionPath(lambda t: (np.sin(5 * t), 3 * t**2, 0.0))
    for time in (0.4, 1.0, 0.7, 0.4):
        expected = [(1 - np.cos(5 * time)) / 5, time**3, 0.0]
        np.testing.assert_allclose(path.displacement(time), expected, atol=1e-13)
    np.testing.assert_allclose(path.velocity(0.2), [np.sin(1.0), 0.12, 0.0])


def test_obstacles_move_with_functions():
    x = np.array([[0.0, 0.0, 1.0]])
    plane = Plane(velocity=lambda t: (9.0, 0.0, 2 * t))
    assert plane.gap(x, 0.5)[0] == pytest.approx(0.75)
    np.testing.assert_allclose(plane.velocity_at(0.5), [9, 0, 1])
    ball = Sphere(center=(0, 0, 0), radius=0.2, velocity=lambda t: (0.0, 0.0, -2 * t))
    assert ball.gap(x, 0.5)[0] == pytest.approx(1.05)


def test_what_is_no_velocity_is_named():
    with pytest.raises(InputError, match="velocity"):
        Plane(velocity=(1.0, 2.0))
    with pytest.raises(InputError, match=r"velocity.*at t ="):
        Plane(velocity=lambda t: (np.nan, 0, 0)).gap(np.zeros((1, 3)), 0.1)
