"""The reduced body against derivatives, closed forms and the full-order body."""

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.fem import ElasticBody, surface_load
from physconvex.materials import LAWS
from physconvex.mesh import box_mesh
from physconvex.reduced import BodySamples, CallableWeights, ReducedBody, ReducedSpace
from physconvex.reduced.body import function_by_function

SIZE = (0.3, 0.2, 0.1)
STEP = 1e-6  # m on a body of 0.3 m


def shaken(body: ReducedBody, seed: int, amount: float = 0.01) -> np.ndarray:
    return body.rest + amount * np.random.default_rng(seed).normal(size=body.rest.shape)


def derivative(function, y: np.ndarray, direction: np.ndarray):
    return (function(y + STEP * direction) - function(y - STEP * direction)) / (2 * STEP)


def directions(body: ReducedBody, count: int = 3) -> np.ndarray:
    return np.random.default_rng(9).normal(size=(count, *body.rest.shape))


# --- kinematics


def test_deformation_gradient_is_the_derivative_of_the_map(mixed_body):
    body = mixed_body()
    y, points = shaken(body, 1), body.space.samples.interior.points
    moved = [
        (body.space.shape_values(points + STEP * e) - body.space.shape_values(points - STEP * e)) @ y / (2 * STEP)
        for e in np.eye(3)
    ]
    np.testing.assert_allclose(body.deformation_gradient(y).numpy(), np.stack(moved, axis=-1), atol=1e-8)


def test_handles_give_the_formula_of_the_paper(space_of):
    space = space_of()
    y = space.rest + 0.02 * np.random.default_rng(2).normal(size=space.rest.shape)
    points = np.random.default_rng(3).uniform(0.01, 0.99, (20, 3)) * SIZE
    weights = np.hstack([np.ones((20, 1)), space.field.at(points)[0]])
    homogeneous = np.hstack([points, np.ones((20, 1))])
    handles = space.handles(y)
    assert handles.shape == (4, 3, 4)
    expected = points + np.einsum("pm,mik,pk->pi", weights, handles, homogeneous)
    np.testing.assert_allclose(space.shape_values(points) @ y, expected, atol=1e-10)
    np.testing.assert_allclose(space.handles(space.rest), 0.0, atol=1e-12)


def test_affine_motions_are_in_the_space(space_of):
    space, rng = space_of(), np.random.default_rng(4)
    linear, shift = rng.normal(size=(3, 3)), rng.normal(size=3)
    points = rng.uniform(size=(10, 3)) * SIZE
    np.testing.assert_allclose(
        space.shape_values(points) @ space.affine(linear, shift), points @ linear.T + shift, atol=1e-12
    )


def test_dependent_weights_are_left_out_and_flat_bodies_refused():
    mesh = box_mesh(SIZE, (1, 1, 1))
    samples = BodySamples.of_mesh(mesh)
    constant = CallableWeights(lambda x: torch.ones(len(x), 1, dtype=x.dtype), 1)
    assert ReducedSpace(constant, samples).dimension == 4
    linear = CallableWeights(lambda x: x[:, :1] + 3, 1)  # W·X adds quadratics, W·1 nothing
    assert ReducedSpace(linear, samples).dimension == 7
    flat = BodySamples.of_points(np.random.default_rng(0).uniform(size=(30, 3)) * [1, 1, 0], 1.0)
    with pytest.raises(InputError, match="plane"):
        ReducedSpace(linear, flat)


# --- mass


@pytest.mark.parametrize("order", [1, 2])
def test_mass_of_affine_motions_is_exact_for_a_heterogeneous_body(mixed_body, order):
    body = mixed_body(order)
    full = ElasticBody(box_mesh(SIZE, (2, 1, 1), order=order), density=body.density)
    assert body.total_mass == pytest.approx(full.total_mass, rel=1e-12)
    assert body.first_moments @ body.space.affine(np.zeros((3, 3)), np.array([1.0, 0, 0]))[:, 0] == pytest.approx(
        body.total_mass
    )
    linear, shift = np.random.default_rng(1).normal(size=(3, 3)), np.array([0.1, -0.4, 0.2])
    v, nodal = body.space.affine(linear, shift), full.mesh.vertices @ linear.T + shift
    assert (v * (body.mass @ v)).sum() == pytest.approx((nodal * (full.mass @ nodal)).sum(), rel=1e-10)
    assert not np.allclose(body.mass, body.mass[0, 0] * np.eye(len(body.mass)), rtol=1e-3)  # it is heterogeneous


def test_uniform_mass_matrix_is_a_multiple_of_the_identity(space_of):
    body = ReducedBody(space_of(), density=800.0)
    np.testing.assert_allclose(body.mass, 800 * 0.006 * np.eye(len(body.mass)), atol=1e-8)


# --- elasticity


@pytest.mark.parametrize("law", sorted(LAWS))
def test_rest_state_has_no_energy_and_no_force(mixed_body, law):
    body = mixed_body(2, law)
    assert abs(body.energy(body.rest)) < 1e-12 * body.shear_scale
    assert np.abs(body.gradient(body.rest)).max() < 1e-10 * body.shear_scale


@pytest.mark.parametrize("law", sorted(set(LAWS) - {"linear"}))
def test_rigid_motion_costs_no_energy(mixed_body, law):
    body = mixed_body(2, law)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    y = body.space.affine(turn * np.linalg.det(turn), np.array([1.0, 2.0, 3.0]))
    assert abs(body.energy(y)) < 1e-12 * body.shear_scale
    assert np.abs(body.gradient(y)).max() < 1e-9 * body.shear_scale


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", sorted(LAWS))
def test_gradient_and_hessian_by_finite_differences(mixed_body, law, order):
    body = mixed_body(order, law)
    y = shaken(body, 1, 0.002 if law == "neo_hookean_log" else 0.01)  # infinite where turned inside out
    energy, gradient = body.energy_and_gradient(y)
    hessian = body.hessian(y)
    assert energy == pytest.approx(body.energy(y)) and np.abs(hessian - hessian.T).max() < 1e-9 * np.abs(hessian).max()
    for d in directions(body):
        assert (gradient * d).sum() == pytest.approx(derivative(body.energy, y, d), rel=1e-5)
        change = derivative(body.gradient, y, d).ravel()
        np.testing.assert_allclose(hessian @ d.ravel(), change, atol=1e-6 * np.abs(change).max())


def test_hessian_in_blocks_is_the_same(mixed_body, monkeypatch):
    body = mixed_body()
    y = shaken(body, 3)
    whole = body.hessian(y)
    monkeypatch.setattr("physconvex.reduced.body._BLOCK", 18 * body.space.dimension * 5)
    np.testing.assert_allclose(body.hessian(y), whole, atol=1e-12 * np.abs(whole).max())


def test_projected_hessian_is_positive(mixed_body):
    body = mixed_body()
    y = body.rest * [0.3, 1.0, 1.0]  # squeezed: the exact one is indefinite
    assert np.linalg.eigvalsh(body.hessian(y)).min() < -1e-3 * body.shear_scale
    assert np.linalg.eigvalsh(body.hessian(y, project=True)).min() > -1e-9 * body.shear_scale


def test_viscous_force_and_matrix(mixed_body):
    body = mixed_body()
    state, time = body.deformation_gradient(shaken(body, 4)), 0.02
    v = directions(body, 1)[0]
    power, force = body.viscous_energy_and_gradient(state, v, time)
    for d in directions(body):
        slope = derivative(lambda u: body.viscous_energy_and_gradient(state, u, time)[0], v, d)
        assert (force * d).sum() == pytest.approx(slope, rel=1e-6)
    matrix = function_by_function(body.viscous_blocks(state, time))
    np.testing.assert_allclose(matrix @ v.ravel(), force.ravel(), atol=1e-9 * np.abs(force).max())
    spin = np.cross([1.0, -2.0, 0.5], body.rest)
    assert body.viscous_energy_and_gradient(body.deformation_gradient(body.rest), spin, time)[0] < 1e-12 * power


# --- patch test


@pytest.mark.parametrize("law", sorted(LAWS))
def test_a_stretched_bar_returns_the_constants_that_went_in(space_of, law):
    """Affine stretch in equilibrium with end tractions, tested with every mode; E and ν from a small strain."""
    modulus, poisson, strain = 2e5, 0.37, 1e-5
    body = ReducedBody(space_of(1), law=law, youngs_modulus=modulus, poisson_ratio=poisson)
    stretch = np.diag([1 + strain, 1 - poisson * strain, 1 - poisson * strain])
    y = body.space.affine(stretch, np.zeros(3))
    # linear weights times X are quadratic on a face: traction by quadratic faces is exact for them
    quadratic = box_mesh(SIZE, (2, 1, 1), order=2)
    ends = [surface_load(quadratic, lambda c, e=e: np.isclose(c[:, 0], e), (1.0, 0, 0)) for e in (0.0, SIZE[0])]
    traction = body.space.shape_values(quadratic.vertices).T @ (ends[1] - ends[0])
    force = body.gradient(y)
    scale = modulus * strain
    np.testing.assert_allclose(force, scale * traction, atol=2e-4 * scale * np.abs(traction).max())


@pytest.mark.parametrize("law", sorted(LAWS))
def test_homogeneous_deformation_has_the_energy_of_the_full_model(mixed_body, law):
    body = mixed_body(2, law)
    constants = {"youngs_modulus": body.youngs_modulus, "poisson_ratio": body.poisson_ratio}
    full = ElasticBody(box_mesh(SIZE, (2, 1, 1)), law=law, **constants)
    linear = np.eye(3) + 0.1 * np.random.default_rng(6).normal(size=(3, 3))
    expected = full.energy(full.mesh.vertices @ linear.T)
    assert body.energy(body.space.affine(linear, np.ones(3))) == pytest.approx(expected, rel=1e-10)


def test_bad_constants_are_named(space_of):
    for name, value in {"youngs_modulus": -1.0, "poisson_ratio": 0.5, "density": np.ones(3)}.items():
        with pytest.raises(InputError, match=name):
            ReducedBody(space_of(), **{name: value})
