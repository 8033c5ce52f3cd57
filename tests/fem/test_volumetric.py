"""The fast arithmetic of the neo-Hookean laws against the plain one of every law, at random states."""

import numpy as np
import pytest

from physconvex.fem import ElasticBody, box_mesh
from physconvex.volumetric_laws import cofactor_and_determinant

LAWS = ("neo_hookean", "neo_hookean_log")


def bodies(law: str, order: int) -> tuple[ElasticBody, ElasticBody]:
    """The same heterogeneous body with the fast arithmetic and with the plain one."""
    mesh = box_mesh((0.3, 0.2, 0.1), (2, 2, 1), order=order)
    rng, count = np.random.default_rng(3), len(mesh.tets)
    constants = {"youngs_modulus": rng.uniform(1e4, 1e6, count), "poisson_ratio": rng.uniform(0.1, 0.49, count)}
    quick, plain = ElasticBody(mesh, law=law, **constants), ElasticBody(mesh, law=law, **constants)
    assert quick._quick is not None
    plain._quick = None
    return quick, plain


def states(body: ElasticBody, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, far from rest but with J > 0, velocities, and positions at which viscosity is frozen."""
    rng, x = np.random.default_rng(seed), body.mesh.vertices
    stretch = np.eye(3) + 0.3 * rng.uniform(-1, 1, (3, 3))
    moved, frozen = (x @ stretch + 4e-3 * rng.normal(size=x.shape) for _ in range(2))
    return moved, rng.normal(size=x.shape), frozen


def assert_close(got: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", LAWS)
def test_energy_forces_and_stiffness(law, order, seed):
    quick, plain = bodies(law, order)
    x, _, _ = states(quick, seed)
    (energy, forces), (expected, expected_forces) = (body.energy_and_gradient(x) for body in (quick, plain))
    assert energy == pytest.approx(expected, rel=1e-12)
    assert_close(forces, expected_forces)
    assert_close(quick.element_hessians(x), plain.element_hessians(x))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", LAWS)
def test_viscosity(law, order):
    quick, plain = bodies(law, order)
    x, velocity, frozen = states(quick, 7)
    state = quick.viscous_state(frozen)
    moving = [
        body.moving_energy_and_gradient(x, velocity, state, damping_time=0.003, step=0.01) for body in (quick, plain)
    ]
    assert moving[0][0] == pytest.approx(moving[1][0], rel=1e-12)
    assert_close(moving[0][1], moving[1][1])
    alone = [
        body.moving_energy_and_gradient(x, velocity, state, damping_time=0.003, step=0.01, with_energy=False)
        for body in (quick, plain)
    ]
    assert np.isnan(alone[0][0])
    assert_close(alone[0][1], alone[1][1])
    assert_close(*(body.element_hessians(x, viscous_state=state, damping_ratio=2.5) for body in (quick, plain)))


def test_a_flat_body_has_a_stiffness_too():
    quick, plain = bodies("neo_hookean", 2)
    x = quick.mesh.vertices * [1.0, 1.0, 0.0]
    assert quick._quick is not None and quick._quick.stiffness(x) is None  # J = 0: the formula divides by it
    assert_close(quick.element_hessians(x), plain.element_hessians(x))
    assert_close(quick.gradient(x), plain.gradient(x))


def test_a_projected_stiffness_is_the_plain_one():
    quick, plain = bodies("neo_hookean", 2)
    x = states(quick, 1)[0]
    assert_close(*(body.element_hessians(x, project=True) for body in (quick, plain)))


def test_logarithms_of_a_body_turned_inside_out_are_infinite():
    quick, _ = bodies("neo_hookean_log", 1)
    assert quick.energy(quick.mesh.vertices * [1.0, 1.0, -1.0]) == np.inf


def test_cofactor_is_the_transposed_inverse_times_the_determinant():
    f = np.random.default_rng(0).normal(size=(50, 3, 3))
    cofactor, determinant = cofactor_and_determinant(np.ascontiguousarray(f.transpose(1, 2, 0)))
    np.testing.assert_allclose(determinant, np.linalg.det(f), atol=1e-12)
    expected = np.linalg.det(f)[:, None, None] * np.linalg.inv(f).transpose(0, 2, 1)
    np.testing.assert_allclose(cofactor.transpose(2, 0, 1), expected, atol=1e-10)
