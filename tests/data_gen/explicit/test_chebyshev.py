"""Stability and order of the steps on the scalar equation y' = λ y."""

import numpy as np
import pytest

from data_gen.explicit.chebyshev import chebyshev_coefficients, reach, stages_for


def one_step(z: np.ndarray, stages: int) -> np.ndarray:
    """y(h) / y(0) for λ h = z, by the recursion that the kernel runs."""
    rows, older, before = chebyshev_coefficients(stages), np.zeros_like(z), np.zeros_like(z)
    for mu, nu, new, first in rows[1:]:
        older, before = before, mu * before + nu * older + new * z * (1 + before) + first * z
    return 1 + before


@pytest.mark.parametrize("stages", [2, 5, 20, 103])
def test_decay_is_never_growth(stages):
    axis = -np.linspace(0, reach(stages), 5000)
    assert np.abs(one_step(axis, stages)).max() <= 1 + 1e-9
    assert np.abs(one_step(np.array([-1.2 * reach(stages)]), stages))[0] > 1


@pytest.mark.parametrize("share", [0.25, 1.0, 2.0])
def test_oscillations_of_a_viscous_body_do_not_grow(share):
    """Modes of a Kelvin–Voigt body that swing lie on the circle |λ + 1/τ| = 1/τ; `share` is step over τ."""
    circle = share * (np.exp(1j * np.linspace(0.05, np.pi, 400)) - 1)
    assert np.abs(one_step(circle, 20)).max() <= 1 + 1e-9


def test_the_error_of_a_step_is_of_third_order():
    steps = np.array([0.02, 0.01, 0.005])
    error = np.abs(one_step((-0.6 + 0.8j) * steps, 20) - np.exp((-0.6 + 0.8j) * steps))
    assert np.log2(error[:-1] / error[1:]) == pytest.approx(3, abs=0.1)


@pytest.mark.parametrize("stiffness", [3.0, 80.0, 5e3])
def test_as_few_stages_as_reach_so_far(stiffness):
    stages = stages_for(stiffness)
    assert reach(stages) >= stiffness > reach(stages - 1)
