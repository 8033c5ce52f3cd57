"""The fast arithmetic of the neo-Hookean laws against the general one."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex.materials import get_law
from physconvex.reduced import ReducedBody


@pytest.mark.parametrize("law", ["neo_hookean", "neo_hookean_log"])
def test_same_energy_forces_and_hessian_as_the_general_arithmetic(mixed_body, law):
    body = mixed_body(2, law)
    general = ReducedBody(
        body.space,
        law=replace(get_law(law)),  # a copy is not recognised
        youngs_modulus=body.youngs_modulus,
        poisson_ratio=body.poisson_ratio,
        density=body.density,
    )
    assert body._quick is not None and general._quick is None
    for seed, stretch in ((0, [1, 1, 1]), (1, [0.7, 1.3, 1.1])):
        y = body.rest * stretch + 0.002 * np.random.default_rng(seed).normal(size=body.rest.shape)
        energy, forces = general.energy_and_gradient(y)
        found, pushed = body.energy_and_gradient(y)
        assert found == pytest.approx(energy, rel=1e-11)
        np.testing.assert_allclose(pushed, forces, atol=1e-11 * np.abs(forces).max())
        hessian = general.hessian(y)
        np.testing.assert_allclose(body.hessian(y), hessian, atol=1e-10 * np.abs(hessian).max())


def test_a_flattened_body_takes_the_general_arithmetic(mixed_body):
    body = mixed_body(1)
    flat = body.rest * [1.0, 1.0, 0.0]
    assert body._quick is not None and body._quick.hessian_blocks(flat) is None
    assert np.isfinite(body.hessian(flat)).all()


def test_an_overturned_body_has_infinite_energy_under_the_logarithmic_law(mixed_body):
    body = mixed_body(1, "neo_hookean_log")
    assert body.energy_and_gradient(body.rest * [1.0, 1.0, -1.0])[0] == np.inf
