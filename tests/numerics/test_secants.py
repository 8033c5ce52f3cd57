"""Broyden's update explains the last change of a function."""

import numpy as np

from physconvex.numerics import broyden_update

SCALES = np.array([0.2, 0.1, 2e-3])


def test_an_update_explains_the_change_and_leaves_other_directions_alone():
    rng = np.random.default_rng(0)
    slope, change = rng.normal(size=(4, 3, 5, 3)), rng.normal(size=(4, 5, 3))
    step = SCALES * np.array([1.0, -2.0, 0.5])
    updated = broyden_update(slope, step, change, SCALES)
    np.testing.assert_allclose(np.einsum("tkpi,k->tpi", updated, step), change, atol=1e-12)
    across = SCALES * np.array([2.0, 1.0, 0.0])  # at right angles, in typical steps
    np.testing.assert_allclose(*(np.einsum("tkpi,k->tpi", s, across) for s in (updated, slope)), atol=1e-12)
    np.testing.assert_array_equal(broyden_update(slope, 1e-6 * step, change, SCALES), slope)
