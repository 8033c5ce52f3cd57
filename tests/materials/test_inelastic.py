"""Flowing materials at one point: derivatives, small strains, and the closed forms of each law."""

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.materials import FlowStep, Plasticine, Sand, StandardLinearSolid, get_law, lame_parameters

E, NU = 2e4, 0.3
MU, LAM = (float(c) for c in lame_parameters(torch.tensor(E), torch.tensor(NU)))
BULK = LAM + 2 / 3 * MU


def tensor(array) -> torch.Tensor:
    return torch.as_tensor(np.asarray(array), dtype=torch.float64)


def response(rule, undo, state=None, step: float = 0.01) -> FlowStep:
    count = len(undo)
    state = torch.linalg.inv(undo) if state is None else state
    mu, lam = torch.full((count,), MU, dtype=torch.float64), torch.full((count,), LAM, dtype=torch.float64)
    return rule.during(undo, state, mu, lam, step)


def random_states(count: int = 30) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """F, F_f⁻¹ of determinant one, and the F at which pressure is taken."""
    rng = np.random.default_rng(0)
    f = np.eye(3) + 0.15 * rng.normal(size=(count, 3, 3))
    undo = np.eye(3) + 0.1 * rng.normal(size=(count, 3, 3))
    undo /= np.cbrt(np.linalg.det(undo))[:, None, None]
    state = np.linalg.inv(undo) * rng.uniform(0.9, 1.02, size=(count, 1, 1))
    return tensor(f), tensor(undo), tensor(state)


def identity(count: int = 1) -> torch.Tensor:
    return torch.eye(3, dtype=torch.float64).expand(count, 3, 3)


NEO_HOOKEAN = [Plasticine(2000.0, "neo_hookean"), Plasticine(2000.0, "neo_hookean_log")]
RULES = [Plasticine(2000.0), Plasticine(1e9), Sand(0.6), StandardLinearSolid(2.0, 0.03), *NEO_HOOKEAN]


@pytest.mark.parametrize("rule", RULES)
def test_stress_and_hessian_by_finite_differences(rule):
    f, undo, state = random_states()
    law, step = response(rule, undo, state), 1e-6
    stress, hessian = law.stress(f), law.hessian(f).unflatten(-1, (3, 3)).unflatten(-3, (3, 3))
    # the potential has kinks in its second derivative where flow sets in: differences across one are left out
    for k in range(3):
        for j in range(3):
            shift = torch.zeros(3, 3, dtype=torch.float64)
            shift[k, j] = step
            slope = (law.energy(f + shift) - law.energy(f - shift)) / (2 * step)
            np.testing.assert_allclose(stress[:, k, j], slope, rtol=1e-5, atol=1e-4 * MU * step**0.5)
            change = (law.stress(f + shift) - law.stress(f - shift)) / (2 * step)
            np.testing.assert_allclose(hessian[..., k, j], change, rtol=1e-4, atol=1e-5 * MU)


@pytest.mark.parametrize("rule", RULES)
def test_hessian_where_stretches_coincide(rule):
    """At F = s I the difference quotients become derivatives."""
    f, undo = 0.97 * identity(), identity()
    law, step = response(rule, undo, f), 1e-6
    hessian = law.hessian(f).unflatten(-1, (3, 3)).unflatten(-3, (3, 3))
    shift = torch.zeros(3, 3, dtype=torch.float64)
    shift[0, 1] = step
    change = (law.stress(f + shift) - law.stress(f - shift)) / (2 * step)
    np.testing.assert_allclose(hessian[..., 0, 1], change, atol=1e-5 * MU)


@pytest.mark.parametrize("rule", [Plasticine(500.0), StandardLinearSolid(1.0, 0.1), *NEO_HOOKEAN])
def test_small_strains_are_linear_elasticity(rule):
    law, f = response(rule, identity(), step=0.0), identity()
    assert float(law.energy(f)) == 0.0 and float(law.stress(f).abs().max()) < 1e-12
    one = tensor([1.0])
    lam = -2 / 3 * MU if isinstance(rule, StandardLinearSolid) else LAM  # the Maxwell element has no volume part
    expected = get_law("linear").hessian(f, MU * one, lam * one)
    np.testing.assert_allclose(law.hessian(f), expected, atol=1e-9 * MU)


@pytest.mark.parametrize("rule", [Plasticine(500.0), *NEO_HOOKEAN])
def test_turned_inside_out_is_infinite(rule):
    f = tensor(np.diag([-1.0, 1.0, 1.0]))[None]
    assert torch.isinf(response(rule, identity()).energy(f)).all()


@pytest.mark.parametrize("law", ["neo_hookean", "neo_hookean_log"])
def test_what_does_not_yield_has_the_law_of_the_body(law):
    f, undo, _ = random_states()
    step, elastic = response(Plasticine(1e9, law), undo), f @ undo
    one = torch.ones(len(f), dtype=torch.float64)
    np.testing.assert_array_equal(step.energy(f), get_law(law).energy(elastic, MU * one, LAM * one))
    np.testing.assert_allclose(step.stress(f), get_law(law).stress(elastic, MU * one, LAM * one) @ undo.mT, atol=1e-9)
    np.testing.assert_array_equal(step.flowed(f), undo)


@pytest.mark.parametrize("rule", [Plasticine(500.0), *NEO_HOOKEAN])
@pytest.mark.parametrize("amplitude", [0.06, 0.3, 1.0])
def test_what_has_yielded_lies_on_the_yield_surface_and_yields_no_further(rule, amplitude):
    rng = np.random.default_rng(3)
    f = tensor(np.eye(3) + amplitude * rng.normal(size=(40, 3, 3)))
    f = f[torch.linalg.det(f) > 0.05]
    law = response(rule, identity(len(f)))
    kirchhoff = law.stress(f) @ f.mT
    mean = kirchhoff.diagonal(dim1=-2, dim2=-1).mean(-1)
    size = torch.linalg.matrix_norm(kirchhoff - mean[:, None, None] * torch.eye(3)) * np.sqrt(1.5)
    assert float(size.max()) <= rule.yield_stress * (1 + 1e-9) and (size > 0.999 * rule.yield_stress).any()
    undo = law.flowed(f)
    np.testing.assert_allclose(torch.linalg.det(undo), 1.0, atol=1e-9)
    again = response(rule, undo)
    np.testing.assert_allclose(again.stress(f), law.stress(f), atol=1e-6 * rule.yield_stress)
    np.testing.assert_allclose(again.flowed(f), undo, rtol=1e-8, atol=1e-9)
    lost = law.energy(f) - again.energy(f)  # to the flow, which is none backwards
    assert float(lost.min()) > -1e-9 * MU


def test_a_pulled_bar_yields_at_the_yield_stress():
    """Uniaxial: Kirchhoff stress E ε below τ_Y, τ_Y beyond; strains ε along and −ν ε across while it is elastic."""
    yield_stress = 500.0
    law = response(Plasticine(yield_stress), identity())
    onset = yield_stress / E
    for strain in (0.5 * onset, 0.999 * onset):
        f = tensor(np.diag(np.exp(strain * np.array([1, -NU, -NU]))))[None]
        kirchhoff = (law.stress(f) @ f.mT)[0]
        np.testing.assert_allclose(kirchhoff, np.diag([E * strain, 0, 0]), atol=1e-6 * yield_stress)
        np.testing.assert_allclose(law.flowed(f), identity(), atol=1e-12)
    # beyond: volume −> pressure τ_Y/3 K⁻¹, shear flows at |dev τ| = √(2/3) τ_Y
    volume = yield_stress / (3 * BULK)
    f = tensor(np.diag(np.exp(np.array([0.2, -0.1, -0.1]) + volume / 3)))[None]
    np.testing.assert_allclose((law.stress(f) @ f.mT)[0], np.diag([yield_stress, 0, 0]), atol=1e-6 * yield_stress)
    undo = law.flowed(f)
    assert float(torch.linalg.det(undo)) == pytest.approx(1.0)
    # what is left is elastic: the same stress without further flow
    again = response(Plasticine(yield_stress), undo)
    np.testing.assert_allclose(again.stress(f), law.stress(f), atol=1e-8 * yield_stress)
    np.testing.assert_allclose(again.flowed(f), undo, atol=1e-12)


def test_sheared_plasticine_yields_at_its_share():
    """Simple shear, small strains: τ = μ γ below τ_Y/√3, not above."""
    yield_stress = 20.0
    law = response(Plasticine(yield_stress), identity())
    onset = yield_stress / np.sqrt(3) / MU
    for shear, expected in ((0.9 * onset, 0.9), (3 * onset, 1.0)):
        f = identity().clone()
        f[0, 0, 1] = shear
        assert float(law.stress(f)[0, 0, 1]) == pytest.approx(expected * yield_stress / np.sqrt(3), rel=2 * shear)


@pytest.mark.parametrize("degrees", [10.0, 30.0])
def test_sand_pressed_along_an_axis_fails_at_its_friction_angle(degrees):
    """Triaxial compression: (τ₃ − τ₁)/(τ₃ + τ₁) = sin φ for the pressures along and across."""
    strain = np.array([-0.2, 0.05, 0.05])
    f = tensor(np.diag(np.exp(strain)))[None]
    law = response(Sand(np.radians(degrees)), identity(), state=f)
    along, across = (-(law.stress(f) @ f.mT)[0].diagonal()).tolist()[:2]
    assert (along - across) / (along + across) == pytest.approx(np.sin(np.radians(degrees)), rel=1e-9)
    elastic = response(Plasticine(1e12), identity())
    stiff = (-(elastic.stress(f) @ f.mT)[0].diagonal()).tolist()
    assert sum(stiff) == pytest.approx(along + 2 * across)  # pressure is elastic
    assert (stiff[0] - stiff[1]) / (stiff[0] + stiff[1]) > np.sin(np.radians(degrees))


def test_sand_has_no_tension_and_no_shear_without_pressure():
    pulled = tensor(np.diag([1.02, 1.0, 1.0]))[None]
    law = response(Sand(0.5), identity(), state=pulled)
    np.testing.assert_array_equal(law.stress(pulled), 0.0)
    sheared = identity().clone()
    sheared[0, 0, 1] = 0.1
    np.testing.assert_allclose(response(Sand(0.5), identity(), state=sheared).stress(sheared), 0.0, atol=1e-9)
    # opened by 2 %, it resists again when that has closed, not before
    undo = law.flowed(pulled)
    back = tensor(np.diag([1.005, 1.0, 1.0]))[None]
    np.testing.assert_allclose(response(Sand(0.5), undo, state=back).stress(back), 0.0, atol=1e-9)


def test_held_maxwell_element_relaxes_exponentially_whatever_the_steps():
    rule, f = StandardLinearSolid(2.0, 0.2), identity().clone()
    f[0, 0, 1] = 0.05
    start = response(rule, identity(), step=0.0).stress(f)
    for count in (3, 12):
        undo = identity()
        for _ in range(count):
            law = response(rule, undo, step=0.3 / count)
            last, undo = law.stress(f), law.flowed(f)
        np.testing.assert_allclose(last, np.exp(-0.3 / 0.2) * start, rtol=5e-3, atol=1e-3 * float(start.abs().max()))


@pytest.mark.wrong_types
def test_bad_constants_are_named():
    for name, make in {
        "yield_stress": lambda: Plasticine(0.0),
        "elastic": lambda: Plasticine(1.0, "stvk"),
        "friction_angle": lambda: Sand(30.0),
        "relaxation_time": lambda: StandardLinearSolid(1.0, -1.0),
        "modulus_ratio": lambda: StandardLinearSolid(np.nan, 1.0),
    }.items():
        with pytest.raises(InputError, match=name):
            make()
