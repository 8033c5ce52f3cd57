"""Residuals by how a body moves: squares stay, rigid motions and strains lie where they should."""

import numpy as np
import pytest

from physconvex.gap.base.body_modes import TurnedObservations, body_modes
from physconvex.identify import MarkerObservations

FRAMES, POINTS = 5, 30
WHOLE, STRAIN, REST = 0, 1, 2


@pytest.fixture
def seen(rng):
    rest = rng.normal(size=(POINTS, 3)) * [0.3, 0.1, 0.2]
    positions = np.repeat(rest[None], FRAMES, axis=0) + 0.01 * rng.normal(size=(FRAMES, POINTS, 3))
    positions[1, :7] = np.nan
    positions[3, :-4] = np.nan  # too few points to divide
    positions[4] = np.nan  # none at all
    return MarkerObservations(rest, positions, 1e-3 * rng.uniform(0.5, 2.0, size=(FRAMES, POINTS)))


@pytest.fixture
def modes(seen):
    return body_modes(seen, free=True)


def shares(seen, modes, displacements):
    """Of the squares of a small motion of the markers, by kind, in the frames that are divided."""
    where = np.nan_to_num(seen.positions)
    rows = seen.residuals(where + displacements) - seen.residuals(where)
    squares = modes.turn(rows) ** 2 * (seen.frames < 3)
    return np.bincount(modes.kinds, squares, minlength=3) / squares.sum()


def test_squares_and_products_stay(seen, modes, rng):
    rows = rng.normal(size=(3, len(seen.frames)))
    turned = modes.turn(rows)
    assert not np.allclose(turned, rows)
    for frame in range(FRAMES):
        own = seen.frames == frame
        np.testing.assert_allclose(turned[:, own] @ turned[:, own].T, rows[:, own] @ rows[:, own].T, atol=1e-10)


def test_each_motion_is_of_its_kind(seen, modes, rng):
    x, matrix = np.nan_to_num(seen.positions), rng.normal(size=(3, 3))
    rigid = shares(seen, modes, 1e-3 * (rng.normal(size=3) + x @ (matrix - matrix.T)))
    assert rigid[WHOLE] == pytest.approx(1.0, abs=1e-12)
    strain = shares(seen, modes, 1e-3 * x @ (matrix + matrix.T))
    assert strain[REST] == pytest.approx(0.0, abs=1e-12) and strain[STRAIN] > 0.3
    assert shares(seen, modes, 1e-3 * np.sin(40 * x))[REST] > 0.3


def test_what_cannot_be_divided_stays(seen, modes, rng):
    rows, last = rng.normal(size=len(seen.frames)), seen.frames == 3
    assert last.any() and (modes.turn(rows)[last] == rows[last]).all() and (modes.kinds[last] == WHOLE).all()
    held = body_modes(seen, free=False)
    assert held.count == 1 and (held.turn(rows) == rows).all()


def test_points_in_a_plane_have_no_strain_across_it(rng):
    rest = np.c_[rng.normal(size=(POINTS, 2)), np.zeros(POINTS)]
    seen = MarkerObservations(rest, rest[None].repeat(2, axis=0), np.full((2, POINTS), 1e-3))
    modes = body_modes(seen, free=True)
    assert (np.bincount(modes.kinds, minlength=3)[:2] == [12, 6]).all()  # xz and yz are turns, to first order; zz none
    rows = rng.normal(size=len(seen.frames))
    np.testing.assert_allclose(np.linalg.norm(modes.turn(rows)), np.linalg.norm(rows))


def test_turned_observations_have_turned_derivatives(seen, modes, rng):
    sigma = rng.uniform(1.0, 3.0, size=len(seen.frames))
    turned = TurnedObservations(seen, modes, sigma)
    positions, tangents = np.nan_to_num(seen.positions), rng.normal(size=(FRAMES, 4, POINTS, 3))
    residuals, jacobian = turned.linearise(positions, tangents)
    np.testing.assert_array_equal(residuals, turned.residuals(positions))
    step = 1e-4 * rng.normal(size=4)
    moved = turned.residuals(positions + np.einsum("tkpi,k->tpi", tangents, step))
    np.testing.assert_allclose(moved - residuals, jacobian @ step, atol=1e-9)
    first = turned.in_frames(2)
    rows = seen.frames < 2
    np.testing.assert_allclose(first.residuals(positions[:2]), residuals[rows], atol=1e-12)


def test_frames_from_the_first_contact_on_are_kinds_of_their_own(seen, modes):
    force = np.array([0.0, 0.0, 3.0, 0.0, 0.0])
    struck = body_modes(seen, free=True, force=force)
    np.testing.assert_array_equal(struck.kinds, modes.kinds + 3 * (seen.frames >= 2))
    assert list(struck.parts) == [0, 1, 2] * 2 and list(struck.struck) == [False] * 3 + [True] * 3
    rows = np.arange(len(seen.frames), dtype=float)
    np.testing.assert_array_equal(struck.turn(rows), modes.turn(rows))


def test_the_rigid_motion_after_an_impact_counts_by_the_frames_of_contact(seen):
    force = np.array([0.0, 2.0, 0.0, 0.0, 0.0])
    numbers = body_modes(seen, free=True, force=force).independent
    assert list(numbers) == [1.5, 1.5, 3.0, 1.5 * 2 / 4, 1.5, 3.0]  # of four frames, one of contact and one beside it
    still = body_modes(seen, free=True, force=np.zeros(FRAMES))
    assert list(still.independent[:3]) == [1.5, 1.5, 3.0] and not (still.kinds >= 3).any()  # nothing was struck


def test_a_struck_body_flies_on_across_the_normal_as_a_kind_of_its_own(seen):
    normal = np.array([0.6, 0.0, 0.8])
    force = np.array([0.0, 2.0, 0.0, 0.0, 0.0])
    modes = body_modes(seen, free=True, force=force, normal=normal)
    plain = body_modes(seen, free=True, force=force)
    assert modes.count == 7 and list(modes.across) == [False] * 6 + [True] and modes.parts[6] == 0 and modes.struck[6]
    divided = np.isin(seen.frames, [1, 2])
    assert ((modes.kinds == 6) & divided).sum() == 4 and ((modes.kinds == 3) & divided).sum() == 8
    assert (modes.kinds[seen.frames == 0] == plain.kinds[seen.frames == 0]).all()  # not in flight
    assert sum(modes.freedom) == sum(plain.freedom) and modes.independent[6] == pytest.approx(0.5 * 2 / 4)
    where = np.nan_to_num(seen.positions)
    for along, kind in ((normal, 3), (np.array([0.0, 1.0, 0.0]), 6), (np.array([0.8, 0.0, -0.6]), 6)):
        rows = seen.residuals(where + 1e-3 * along) - seen.residuals(where)
        squares = modes.turn(rows) ** 2 * divided
        assert squares[modes.kinds == kind].sum() == pytest.approx(squares.sum())
    turning = seen.residuals(where + 1e-3 * np.cross([1.0, 2.0, 3.0], where)) - seen.residuals(where)
    np.testing.assert_allclose(np.linalg.norm(modes.turn(turning)), np.linalg.norm(turning))
