"""Fibres and stiffening: derivatives, linear elasticity, and moduli along and across."""

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.materials import get_law, lame_parameters, with_fibres, with_strain_stiffening

E, NU = 3e4, 0.3
MU, LAM = lame_parameters(torch.tensor(E, dtype=torch.float64), torch.tensor(NU, dtype=torch.float64))
EYE = torch.eye(3, dtype=torch.float64)
LAWS = [
    with_fibres("neo_hookean", (1.0, 2.0, -0.5), 3.0),
    with_strain_stiffening("corotated", 2.0),
    with_strain_stiffening(with_fibres("stvk", np.random.default_rng(1).normal(size=(20, 3)), 1.5), 0.7),
]


@pytest.mark.parametrize("law", LAWS)
def test_stress_and_hessian_by_finite_differences(law):
    f = EYE + 0.15 * torch.as_tensor(np.random.default_rng(0).normal(size=(20, 3, 3)))
    step, scale = 1e-6, float(MU)
    stress, hessian = law.stress(f, MU, LAM), law.hessian(f, MU, LAM).unflatten(-1, (3, 3)).unflatten(-3, (3, 3))
    for k in range(3):
        for j in range(3):
            shift = torch.zeros_like(EYE)
            shift[k, j] = step
            slope = (law.energy(f + shift, MU, LAM) - law.energy(f - shift, MU, LAM)) / (2 * step)
            np.testing.assert_allclose(stress[:, k, j], slope, rtol=1e-6, atol=1e-6 * scale)
            change = (law.stress(f + shift, MU, LAM) - law.stress(f - shift, MU, LAM)) / (2 * step)
            np.testing.assert_allclose(hessian[..., k, j], change, rtol=1e-6, atol=1e-6 * scale)


def test_stiffening_leaves_small_strains_linear_and_grows_with_shear():
    law = with_strain_stiffening("neo_hookean", 2.0)
    np.testing.assert_allclose(
        law.hessian(EYE[None], MU, LAM), get_law("linear").hessian(EYE[None], MU, LAM), atol=1e-9 * float(MU)
    )
    sheared = EYE.clone()
    sheared[0, 1] = 0.4
    gain = law.stress(sheared, MU, LAM) - get_law("neo_hookean").stress(sheared, MU, LAM)
    assert float(gain[0, 1]) == pytest.approx(2 * 2.0 * float(MU) * 0.4**3)


def test_fibres_stiffen_a_bar_along_them_as_stated_and_hardly_across():
    """Moduli from the compliance at F = I: E + k along, E/(1 − ν² k/(E + k)) across."""
    ratio = 5.0
    law, k = with_fibres("corotated", (0, 0, 2.0), ratio), ratio * float(MU)
    symmetric = []
    for i, j in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)):
        strain = torch.zeros_like(EYE)
        strain[i, j], strain[j, i] = (1.0, 1.0) if i == j else (0.5, 0.5)
        symmetric.append(strain.flatten())
    basis = torch.stack(symmetric)
    compliance = np.linalg.inv((basis @ law.hessian(EYE, MU, LAM) @ basis.T).numpy())
    assert 1 / compliance[2, 2] == pytest.approx(E + k)
    assert 1 / compliance[0, 0] == pytest.approx(E / (1 - NU**2 * k / (E + k)))
    assert 1 / compliance[5, 5] == pytest.approx(float(MU))  # shear across the fibres


@pytest.mark.wrong_types
def test_bad_terms_are_named():
    with pytest.raises(InputError, match="direction"):
        with_fibres("stvk", (0, 0, 0), 1.0)
    with pytest.raises(InputError, match="modulus_ratio"):
        with_fibres("stvk", (0, 0, 1), -1.0)
    with pytest.raises(InputError, match="rate"):
        with_strain_stiffening("stvk", -1.0)
