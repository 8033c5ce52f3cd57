"""Elastic laws: energy, stress and hessian agree with each other, linear elasticity and autograd."""

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.materials import LAWS, get_law, lame_parameters, project_to_positive, strain_stiffness

ROTATION_INVARIANT = sorted(set(LAWS) - {"linear"})
WITHOUT_BARRIER = sorted(set(LAWS) - {"neo_hookean_log"})
# Central differences with step h of a function of size 1 err by h² (truncation) + 1e-16/h (rounding): 1e-10
# at h = 1e-5; the tolerance leaves room for stresses and derivatives of size 100.
STEP, TOLERANCE = 1e-5, 1e-8
MU, LAM = torch.tensor(0.7, dtype=torch.float64), torch.tensor(1.9, dtype=torch.float64)


def rotations(count: int, seed: int) -> torch.Tensor:
    q = torch.linalg.qr(torch.tensor(np.random.default_rng(seed).normal(size=(count, 3, 3)))).Q
    return q * torch.linalg.det(q)[:, None, None]


def states(singular_values: list[list[float]], seed: int = 0) -> torch.Tensor:
    """One randomly turned F for each triple of (signed) singular values."""
    count = len(singular_values)
    diagonal = torch.diag_embed(torch.tensor(singular_values, dtype=torch.float64))
    return rotations(count, seed) @ diagonal @ rotations(count, seed + 1)


def random_states(count: int = 6, seed: int = 3) -> torch.Tensor:
    return states(np.random.default_rng(seed).uniform(0.6, 1.6, size=(count, 3)).tolist(), seed)


NEARLY_FLAT = states([[1.3, 0.9, 0.05], [1.1, 0.8, 1e-3], [1.2, 1.0, 0.02]])
INVERTED = states([[1.2, 0.9, -0.1], [1.0, 0.8, -0.4]])


def unit_directions() -> torch.Tensor:
    return torch.eye(9, dtype=torch.float64).reshape(9, 3, 3)


def differences(function, f: torch.Tensor) -> torch.Tensor:
    """Central differences of a function of F, the nine directions in the last axis but the values' own."""
    columns = [
        (function(f + STEP * d, MU, LAM) - function(f - STEP * d, MU, LAM)) / (2 * STEP) for d in unit_directions()
    ]
    return torch.stack(columns, dim=-1)


def states_of(name: str) -> torch.Tensor:
    if name == "neo_hookean_log":  # infinite at J ≤ 0, and its derivatives explode near it: keep J ≥ 0.03
        return torch.cat([random_states(), states([[1.3, 0.9, 0.05]])])
    return torch.cat([random_states(), NEARLY_FLAT, INVERTED])


@pytest.mark.parametrize("name", sorted(LAWS))
def test_stress_is_the_derivative_of_the_energy(name):
    law, f = get_law(name), states_of(name)
    got, expected = law.stress(f, MU, LAM).reshape(-1, 9), differences(law.energy, f)
    # the log law's third derivatives grow like 1/s³ = 8000 near its barrier: truncation 1e-10 × 8000
    torch.testing.assert_close(got, expected, rtol=1e-6 if name == "neo_hookean_log" else TOLERANCE, atol=TOLERANCE)


@pytest.mark.parametrize("name", sorted(LAWS))
def test_hessian_is_the_derivative_of_the_stress(name):
    law, f = get_law(name), states_of(name)
    got, expected = law.hessian(f, MU, LAM), differences(law.stress, f).reshape(-1, 9, 9)
    torch.testing.assert_close(got, expected, rtol=1e-6 if name == "neo_hookean_log" else TOLERANCE, atol=TOLERANCE)


@pytest.mark.parametrize("name", sorted(LAWS))
def test_autograd_agrees_with_stress(name):
    law, f = get_law(name), random_states().requires_grad_()
    (gradient,) = torch.autograd.grad(law.energy(f, MU, LAM).sum(), f)
    torch.testing.assert_close(gradient, law.stress(f, MU, LAM), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("name", sorted(LAWS))
def test_autograd_agrees_with_hessian(name):
    law, f = get_law(name), random_states(1)[0]
    jacobian = torch.autograd.functional.jacobian(lambda g: law.stress(g, MU, LAM), f).reshape(9, 9)
    torch.testing.assert_close(law.hessian(f, MU, LAM), jacobian, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("name", sorted(LAWS))
@pytest.mark.parametrize(("e", "nu"), [(1e5, 0.2), (3e6, 0.45), (50.0, -0.3)])
def test_rest_state_is_linear_elasticity(name, e, nu):
    law, identity = get_law(name), torch.eye(3, dtype=torch.float64)
    mu, lam = lame_parameters(torch.tensor(e, dtype=torch.float64), torch.tensor(nu, dtype=torch.float64))
    # C_ijkl = λ δij δkl + μ (δik δjl + δil δjk), written out independently of the module
    eye = np.eye(3)
    c = lam.item() * np.einsum("ij,kl->ijkl", eye, eye)
    c += mu.item() * (np.einsum("ik,jl->ijkl", eye, eye) + np.einsum("il,jk->ijkl", eye, eye))
    np.testing.assert_allclose(law.hessian(identity, mu, lam), c.reshape(9, 9), atol=1e-12 * e)
    assert abs(law.energy(identity, mu, lam)) < 1e-15 * e
    np.testing.assert_allclose(law.stress(identity, mu, lam), 0.0, atol=1e-14 * e)


@pytest.mark.parametrize("name", ROTATION_INVARIANT)
def test_rotation_changes_no_energy_and_turns_the_stress(name):
    law, f, q = get_law(name), random_states(), rotations(6, seed=11)
    torch.testing.assert_close(law.energy(q @ f, MU, LAM), law.energy(f, MU, LAM), rtol=1e-12, atol=1e-13)
    torch.testing.assert_close(law.stress(q @ f, MU, LAM), q @ law.stress(f, MU, LAM), rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(law.stress(q, MU, LAM), 0.0, atol=1e-13)


@pytest.mark.parametrize("name", ROTATION_INVARIANT)
def test_isotropic_laws_do_not_see_a_turn_of_the_rest_state(name):
    law, f, q = get_law(name), random_states(), rotations(6, seed=12)
    torch.testing.assert_close(law.energy(f @ q, MU, LAM), law.energy(f, MU, LAM), rtol=1e-12, atol=1e-13)


def test_linear_law_resists_a_rotation():
    assert get_law("linear").energy(rotations(4, seed=2), MU, LAM).min() > 0.01


@pytest.mark.parametrize("name", sorted(LAWS))
def test_projection_is_positive_and_exact_where_nothing_is_negative(name):
    law = get_law(name)
    f = torch.cat([random_states(20), states([[1.001, 0.999, 1.0], [1.0, 1.0, 1.0]])])
    exact = law.hessian(f, MU, LAM)
    projected = project_to_positive(exact)
    smallest = torch.linalg.eigvalsh(projected).min(dim=-1).values
    assert (smallest > -1e-12).all()
    definite = torch.linalg.eigvalsh(exact).min(dim=-1).values >= 0
    torch.testing.assert_close(projected[definite], exact[definite], rtol=1e-12, atol=1e-12)


def test_projection_removes_exactly_the_negative_part():
    exact = get_law("neo_hookean").hessian(states([[0.5, 0.5, 0.4]]), MU, LAM)
    values, vectors = torch.linalg.eigh(exact)
    assert values.min() < -0.1  # strong compression: the exact Hessian is indefinite
    removed = project_to_positive(exact) - exact
    expected = (vectors * (-values.clamp_max(0)).unsqueeze(-2)) @ vectors.mT
    torch.testing.assert_close(removed, expected)


def test_log_law_is_infinite_when_inverted():
    assert torch.isinf(get_law("neo_hookean_log").energy(INVERTED, MU, LAM)).all()


@pytest.mark.parametrize("name", WITHOUT_BARRIER)
def test_other_laws_are_finite_when_inverted(name):
    law = get_law(name)
    for values in (law.energy, law.stress, law.hessian):
        assert torch.isfinite(values(INVERTED, MU, LAM)).all()


def test_viscosity_tensor_is_the_strain_part_of_stvk():
    # at F = R the second stress vanishes and the whole StVK Hessian is the strain part
    f = rotations(3, seed=5)
    torch.testing.assert_close(
        strain_stiffness(f, MU, LAM), get_law("stvk").hessian(f, MU, LAM), rtol=1e-12, atol=1e-12
    )


def test_constants_go_there_and_back():
    e, nu = torch.tensor([1e4, 2e6], dtype=torch.float64), torch.tensor([0.2, 0.49], dtype=torch.float64)
    mu, lam = lame_parameters(e, nu)
    torch.testing.assert_close(mu * (3 * lam + 2 * mu) / (lam + mu), e)
    torch.testing.assert_close(lam / (2 * (lam + mu)), nu)


@pytest.mark.parametrize("name", sorted(LAWS))
def test_constants_may_differ_from_state_to_state(name):
    law, f = get_law(name), random_states()
    mu, lam = torch.linspace(0.5, 2, 6, dtype=torch.float64), torch.linspace(1, 4, 6, dtype=torch.float64)
    for function in (law.energy, law.stress, law.hessian):
        together = function(f, mu, lam)
        one_by_one = torch.stack([function(a, m, n) for a, m, n in zip(f, mu, lam, strict=True)])
        torch.testing.assert_close(together, one_by_one)


@pytest.mark.parametrize("name", sorted(LAWS))
def test_single_precision_stays_single(name):
    law, f = get_law(name), random_states()
    small = law.stress(f.float(), MU.float(), LAM.float())
    assert small.dtype == torch.float32
    torch.testing.assert_close(small.double(), law.stress(f, MU, LAM), rtol=1e-4, atol=1e-5)


def test_unknown_law_is_named():
    with pytest.raises(InputError, match=r"law: got 'rubber'; expected one of neo_hookean, "):
        get_law("rubber")
