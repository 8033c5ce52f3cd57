"""The best rotation between two sets of points."""

import numpy as np
from scipy.spatial.transform import Rotation

from physconvex.numerics import best_rotation, beyond_rigid


def test_a_turned_and_moved_body_tells_its_turn():
    rng = np.random.default_rng(0)
    points, turn = rng.normal(size=(9, 3)), Rotation.from_rotvec([0.3, -1.1, 2.0]).as_matrix()
    np.testing.assert_allclose(best_rotation(points, points @ turn.T + [1.0, -2.0, 3.0]), turn, atol=1e-12)


def test_a_mirror_image_gives_a_rotation_still():
    points = np.random.default_rng(1).normal(size=(9, 3))
    assert np.linalg.det(best_rotation(points, points * [1.0, 1.0, -1.0])) > 0.999


def test_weights_choose_which_points_are_followed():
    rng = np.random.default_rng(2)
    points, turn = rng.normal(size=(8, 3)), Rotation.from_rotvec([0.0, 0.0, 0.7]).as_matrix()
    now = points @ turn.T
    now[4:] += rng.normal(size=(4, 3))
    weights = np.array([1.0] * 4 + [0.0] * 4)
    np.testing.assert_allclose(best_rotation(points, now, weights), turn, atol=1e-12)
    assert np.abs(best_rotation(points, now) - turn).max() > 1e-2


def test_points_in_a_line_give_their_direction():
    line = np.outer(np.linspace(0.0, 1.0, 5), [1.0, 0.0, 0.0])
    turned = best_rotation(line, np.outer(np.linspace(0.0, 1.0, 5), [0.0, 1.0, 0.0]))
    np.testing.assert_allclose(turned @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)


def test_what_is_left_of_a_rigid_motion_and_a_strain_is_the_turned_strain():
    rng = np.random.default_rng(1)
    rest = rng.normal(size=(20, 3))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    strain = np.diag([0.02, -0.01, 0.03])
    centred = rest - rest.mean(0)
    positions = ((centred + centred @ strain) @ turn.T + [1.0, 2, 3])[None]
    moved, turns = beyond_rigid(rest, positions)
    np.testing.assert_allclose(turns[0], turn, atol=2e-2)
    np.testing.assert_allclose(moved[0], centred @ strain @ turn.T, atol=2e-2 * np.abs(centred).max())
    np.testing.assert_allclose(beyond_rigid(rest, (rest @ turn.T)[None])[0], 0, atol=1e-12)
