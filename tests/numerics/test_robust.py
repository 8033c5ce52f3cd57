"""Huber's loss and its weights."""

import numpy as np

from physconvex.numerics import huber_loss, huber_weights

LIMITS = np.array([1.5, 1.5, np.inf, 0.5])
RESIDUALS = np.array([0.7, -4.0, 30.0, 0.5001])


def test_values():
    expected = 0.5 * 0.7**2 + 1.5 * (4.0 - 0.75) + 0.5 * 30.0**2 + 0.5 * (0.5001 - 0.25)
    np.testing.assert_allclose(huber_loss(RESIDUALS, LIMITS), expected)


def test_weighted_residuals_are_its_gradient():
    steps = 1e-5 * np.eye(4)
    slopes = [(huber_loss(RESIDUALS + h, LIMITS) - huber_loss(RESIDUALS - h, LIMITS)) / 2e-5 for h in steps]
    np.testing.assert_allclose(huber_weights(RESIDUALS, LIMITS) * RESIDUALS, slopes, rtol=1e-6)
