"""Secant corrections of a stale inverse."""

import numpy as np

from physconvex.reduced.dense_newton import Secants


def test_gradients_of_a_quadratic_make_the_inverse_exact_along_what_was_seen():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    hessian = root @ root.T + np.eye(6)
    secants, stale = Secants(6, smallest=1e-12), lambda rhs: rhs / np.diag(hessian)
    x = np.zeros((2, 3))
    secants.note(x, (hessian @ x.ravel()).reshape(2, 3))
    for _ in range(6):  # conjugate steps: each pair is exact for all that follow
        direction = secants.solve(stale, rng.normal(size=6)).reshape(2, 3)
        x = x + direction
        secants.note(x, (hessian @ x.ravel()).reshape(2, 3))
    last = direction.ravel()
    np.testing.assert_allclose(secants.solve(stale, hessian @ last), last, atol=1e-9 * np.abs(last).max())
    secants.forget()
    np.testing.assert_allclose(secants.solve(stale, last), stale(last))


def test_pairs_are_not_taken_across_an_interruption_or_against_the_curvature_or_of_rounding():
    secants, rhs = Secants(4, smallest=1e-3), np.array([1.0, 2.0, 3.0])
    secants.note(np.zeros(3), np.zeros(3))
    secants.interrupt()
    secants.note(rhs, 5 * rhs)
    secants.note(2 * rhs, np.zeros(3))  # the gradient falls along the step
    secants.note(2.0001 * rhs, 7 * rhs)  # a small step
    np.testing.assert_array_equal(secants.solve(np.copy, rhs), rhs)
