"""Orders of convergence, in space and in time, on manufactured problems (docs/figures/fem_cases/convergence.py)."""

import numpy as np
import pytest

from docs.figures.fem_cases.convergence import elastic_displacement, fitted_slope, in_space, in_time


def test_manufactured_solution_satisfies_naviers_equations():
    # μ Δu + (λ + μ) ∇(div u) = 0, i.e. div of the stress, by differences of the exact gradient
    nu, h = 0.3, 1e-5
    points = np.random.default_rng(0).uniform(0.1, 0.9, size=(10, 3))

    def stress(x):
        gradient = elastic_displacement(x)[1]
        trace = np.trace(gradient, axis1=-2, axis2=-1)[..., None, None]
        return gradient + gradient.swapaxes(-1, -2) + 2 * nu / (1 - 2 * nu) * trace * np.eye(3)  # over μ

    shifts = h * np.eye(3)
    force = sum((stress(points + s) - stress(points - s))[..., :, j] / (2 * h) for j, s in enumerate(shifts))
    scale = np.abs(stress(points + shifts[0]) - stress(points - shifts[0])).max() / (2 * h)
    np.testing.assert_allclose(force, 0.0, atol=1e-6 * scale)
    for j, s in enumerate(shifts):
        change = (elastic_displacement(points + s)[0] - elastic_displacement(points - s)[0]) / (2 * h)
        np.testing.assert_allclose(elastic_displacement(points)[1][..., j], change, atol=1e-12)


def test_fitted_slope_of_a_power_law():
    assert fitted_slope([1.0, 0.5, 0.1], [2.0, 2.0 * 0.5**1.7, 2.0 * 0.1**1.7]) == pytest.approx(1.7)


# Theory: an element of degree p errs by h^(p+1) in the displacement and by h^p in its gradient (the energy norm).
# The coarse meshes used here reach that to 0.2.


def test_linear_elements_converge_at_their_order():
    slopes = in_space(1, (2, 4, 8)).slopes()
    assert slopes["displacement"] == pytest.approx(2.0, abs=0.3)
    assert slopes["gradient"] == pytest.approx(1.0, abs=0.3)


def test_quadratic_elements_converge_at_their_order():
    slopes = in_space(2, (2, 4, 6)).slopes()
    assert slopes["displacement"] == pytest.approx(3.0, abs=0.3)
    assert slopes["gradient"] == pytest.approx(2.0, abs=0.3)


def test_quadratic_elements_are_worth_their_nodes():
    # n cells of P2 have the nodes of 2n cells of P1
    linear, quadratic = in_space(1, (8,)).errors["displacement"][0], in_space(2, (4,)).errors["displacement"][0]
    assert quadratic < 0.5 * linear


@pytest.mark.slow
@pytest.mark.parametrize(
    ("integrator", "order", "steps"), [("implicit_euler", 1, (200, 400, 800)), ("bdf2", 2, (50, 100, 200))]
)
def test_integrators_converge_at_their_order(integrator, order, steps):
    # reference: BDF2 with 8 times the steps, whose error is 1/64 of the finest BDF2 error here
    slope = in_time(integrator, steps, reference=1600).slopes()["position"]
    assert slope == pytest.approx(order, abs=0.15)
