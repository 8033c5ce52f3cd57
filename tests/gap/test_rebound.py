"""The way that a body has come since it was struck."""

import numpy as np
import pytest

from physconvex.gap import ErrorModel, PointMotion
from physconvex.gap.base.body_modes import BodyModes
from physconvex.gap.errors.error_model import forgiving, path_since_contact


def motion_of(height):
    rest = np.array([[0.0, 0, 0], [0.1, 0, 0]])
    positions = rest + np.stack([0 * height, 0 * height, height], axis=-1)[:, None]
    return PointMotion(rest, np.arange(len(height)) / 10, positions, np.zeros_like(positions))


def test_the_way_begins_at_the_last_frame_of_the_fall():
    path = path_since_contact(motion_of(np.array([1.0, 0.6, 0.1, 0.4, 0.5])), np.array([0, 0, 5.0, 0, 0]))
    assert path == pytest.approx([0, 0, 0.5, 0.8, 0.9])


def test_a_body_that_lies_comes_no_farther():
    path = path_since_contact(motion_of(np.array([0.5, 0.1, 0.1, 0.1])), np.array([0, 5.0, 5.0, 5.0]))
    assert path == pytest.approx([0, 0.4, 0.4, 0.4])


def test_nothing_touched():
    assert (path_since_contact(motion_of(np.linspace(1, 0, 5)), np.zeros(5)) == 0).all()


def test_a_rebound_as_a_whole_is_forgiven_and_nothing_else():
    kinds = np.arange(6)
    modes = BodyModes(np.zeros(6, dtype=int), kinds, (6.0, 6.0, 12.0) * 2)
    found = forgiving(ErrorModel(np.full(6, 21.0), np.zeros((0, 6)), np.full(6, 5.0)), modes)
    assert found.expected == pytest.approx([5, 5, 5, 1 + 9 * 4, 5, 5])
    assert found.variance == pytest.approx([21, 21, 21, 1 + 9 * 20, 21, 21])
