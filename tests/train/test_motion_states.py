"""States of known motions, and their symmetries."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from models import STATE_NAMES, STATE_SCALE
from train import flipped_states
from train.motion_states import referred_states, states_of_motion

STRETCH = np.diag([1.2, 1.0, 0.8])
TURN = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()


@pytest.fixture
def points() -> np.ndarray:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (500, 3)) * [1.0, 0.8, 0.6]
    return points - points.mean(axis=0)


def column(states: np.ndarray, name: str) -> np.ndarray:
    return states[:, STATE_NAMES.index(name)]


def test_states_of_a_stretched_turned_and_moved_body(points: np.ndarray) -> None:
    motion = np.stack([0 * points, points @ (TURN @ STRETCH).T - points + [0.1, 0.2, -0.3]])
    states = states_of_motion(points, motion, np.ones(500), height=0.9)
    for name, expected in zip(("log_stretch_1", "log_stretch_2", "log_stretch_3"), np.log([1.2, 1, 0.8]), strict=True):
        assert column(states, name)[1] == pytest.approx(expected, abs=1e-6)
    assert column(states, "log_volume")[1] == pytest.approx(np.log(0.96), abs=1e-6)
    np.testing.assert_allclose(states[1, :3], [0.1, 0.2, -0.3], atol=1e-6)
    np.testing.assert_allclose(states[1, 10:].reshape(3, 3) + np.eye(3), TURN @ STRETCH, atol=1e-6)
    assert abs(column(states, "bending")).max() < 1e-6
    assert column(states, "lowest")[0] == pytest.approx(0.9 - 0.3, abs=0.02)
    assert column(states, "height")[0] == pytest.approx(0.6, abs=0.02)
    assert len(STATE_NAMES) == len(STATE_SCALE) == states.shape[1]


def test_bending_is_what_no_affine_motion_does(points: np.ndarray) -> None:
    bent = np.zeros((1, *points.shape))
    bent[0, :, 2] = 0.3 * points[:, 0] ** 2
    states = states_of_motion(points, np.concatenate([bent * 0, bent]), np.ones(500), height=0.9)
    design = np.concatenate([points, np.ones((500, 1))], axis=1)
    rest = bent[0, :, 2] - design @ np.linalg.lstsq(design, bent[0, :, 2], rcond=None)[0]
    assert column(states, "bending")[1] == pytest.approx(np.sqrt((rest**2).mean()), rel=1e-4)


def test_mirror_image_has_mirrored_states(points: np.ndarray) -> None:
    motion, mirror = np.stack([0 * points, points @ (TURN @ STRETCH).T - points]), np.array([-1, 1, 1])
    states = states_of_motion(points, motion, np.ones(500), height=0.9)
    other = states_of_motion(points * mirror, motion * mirror, np.ones(500), height=0.9)
    np.testing.assert_allclose(flipped_states(states), other, atol=1e-6)


def test_a_turned_first_frame_is_the_new_reference(points: np.ndarray) -> None:
    """Dropping the first frame of a body that turns leaves what it does from there on."""
    turned = points @ TURN.T
    later = turned @ STRETCH.T + [0.5, 0, 0]
    motion = np.stack([0 * points, turned - points, later - points])
    states = states_of_motion(points, motion, np.ones(500), height=0.9)
    shown = referred_states(states[1:])
    np.testing.assert_allclose(shown[0, 10:], 0, atol=1e-6)
    np.testing.assert_allclose(shown[1, 10:].reshape(3, 3) + np.eye(3), STRETCH, atol=1e-6)
    assert shown[1, 0] == pytest.approx(0.5, abs=1e-6)
    np.testing.assert_array_equal(shown[:, 3:10], states[1:, 3:10])
