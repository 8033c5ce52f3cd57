"""The fast arithmetic of the neo-Hookean laws, which is compiled, against that of every law, at random states."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from physconvex.fem import ElasticBody, compiled_elements as kernel
from physconvex.fem.compiled_elements import CompiledElements, sum_into
from physconvex.materials import StepViscosity, cofactor_and_determinant
from physconvex.mesh import box_mesh
from tests.kernels.missing import MISSING

LAWS = ("neo_hookean", "neo_hookean_log")


def test_without_a_compiler_the_plain_arithmetic_is_taken(monkeypatch):
    quick, plain = bodies("neo_hookean", 2)
    monkeypatch.setattr(kernel, "FEM_KERNEL", MISSING)
    without = ElasticBody(quick.mesh, youngs_modulus=quick.youngs_modulus, poisson_ratio=quick.poisson_ratio)
    x = states(quick, 2)[0]
    assert without._quick is None
    np.testing.assert_array_equal(without.gradient(x), plain.gradient(x))


def bodies(law: str, order: int, cells: tuple[int, int, int] = (2, 2, 1)) -> tuple[ElasticBody, ElasticBody]:
    """The same heterogeneous body with the fast arithmetic and with the plain one."""
    mesh = box_mesh((0.3, 0.2, 0.1), cells, order=order)
    rng, count = np.random.default_rng(3), len(mesh.tets)
    points = len(ElasticBody(mesh).quadrature_points[0])
    constants = {
        "youngs_modulus": rng.uniform(1e4, 1e6, (count, points)),
        "poisson_ratio": rng.uniform(0.1, 0.49, count),
    }
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


@pytest.mark.parametrize("cells", [(2, 2, 1), (1, 1, 1), (3, 1, 1)])  # 24, 6 and 18 elements
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", LAWS)
def test_energy_forces_and_stiffness(law, order, cells):
    quick, plain = bodies(law, order, cells)
    seed = sum(cells)
    x, _, _ = states(quick, seed)
    (energy, forces), (expected, expected_forces) = (body.energy_and_gradient(x) for body in (quick, plain))
    assert energy == pytest.approx(expected, rel=1e-12)
    assert_close(forces, expected_forces)
    assert_close(quick.element_hessians(x), plain.element_hessians(x))
    room = np.full_like(plain.element_hessians(x), np.nan)
    assert quick.element_hessians(x, out=room) is room
    assert_close(room, plain.element_hessians(x))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", LAWS)
def test_viscosity(law, order):
    quick, plain = bodies(law, order, (1, 3, 1))
    x, velocity, frozen = states(quick, 7)
    viscosity = StepViscosity(quick.deformation_gradient(frozen), damping_time=0.003, step=0.01)
    moving = [body.moving_energy_and_gradient(x, velocity, viscosity) for body in (quick, plain)]
    assert moving[0][0] == pytest.approx(moving[1][0], rel=1e-12)
    assert_close(moving[0][1], moving[1][1])
    alone = [body.moving_energy_and_gradient(x, velocity, viscosity, with_energy=False) for body in (quick, plain)]
    assert np.isnan(alone[0][0])
    assert_close(alone[0][1], alone[1][1])
    assert_close(
        *(body.element_hessians(x, viscosity=replace(viscosity, damping_time=0.025)) for body in (quick, plain))
    )


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


def test_a_body_can_be_sent_to_another_process():
    body, _ = bodies("neo_hookean", 2)
    x = states(body, 4)[0]
    forces = body.gradient(x)
    sent = pickle.loads(pickle.dumps(body._quick))
    assert isinstance(sent, CompiledElements)
    np.testing.assert_array_equal(sent.energy_and_gradient(x)[1], forces)


@pytest.mark.parametrize("compiled", [True, False])
def test_sums_by_slot(compiled, monkeypatch):
    if not compiled:
        monkeypatch.setattr(kernel, "FEM_KERNEL", MISSING)
    rng = np.random.default_rng(0)
    values = rng.normal(size=(4, 3, 3))
    entries = rng.permutation(36)[:30].astype(np.int32)
    slots = rng.integers(0, 5, 30).astype(np.int32)
    expected = [values.ravel()[entries[slots == slot]].sum() for slot in range(7)]
    np.testing.assert_allclose(sum_into(slots, entries, values, 7), expected, atol=1e-14)


def test_positions_of_another_kind_of_number_are_taken_as_they_are():
    body, _ = bodies("neo_hookean", 1)
    x = states(body, 5)[0].astype(np.float32)
    np.testing.assert_array_equal(body.gradient(x), body.gradient(x.astype(np.float64)))
    np.testing.assert_array_equal(body.element_hessians(x), body.element_hessians(x.astype(np.float64)))
