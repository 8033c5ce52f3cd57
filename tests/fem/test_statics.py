"""Equilibria with closed forms: stretched bars give back E and ν, finite stretches of rubber, own weight."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from physconvex import ConvergenceError, InputError
from physconvex.dynamics import Loads, Timing, simulate
from physconvex.fem import ElasticBody, NodePins, Scene, solve_static, surface_load
from physconvex.materials import LAWS
from physconvex.mesh import TetMesh, box_mesh

SIZE = np.array([0.3, 0.1, 0.1])
E, NU = 2e5, 0.35


def bar(order: int) -> TetMesh:
    """Quadratic, or linear with its inner nodes shaken so that no symmetry of the mesh helps."""
    if order == 2:
        return box_mesh(tuple(SIZE), (4, 2, 2))
    mesh = box_mesh(tuple(SIZE), (6, 3, 3), order=1)
    shift = np.random.default_rng(0).uniform(-0.008, 0.008, size=mesh.vertices.shape)
    return TetMesh(mesh.vertices + (mesh.node_areas == 0)[:, None] * shift, mesh.tets)


def pull(mesh: TetMesh, stresses) -> np.ndarray:
    """Balanced tractions [Pa] on opposite sides, one value per axis."""
    forces = np.zeros_like(mesh.vertices)
    for axis, stress in enumerate(stresses):
        traction = stress * np.eye(3)[axis]
        forces += surface_load(mesh, lambda c, a=axis: np.isclose(c[:, a], SIZE[a]), traction)
        forces -= surface_load(mesh, lambda c, a=axis: np.isclose(c[:, a], 0), traction)
    return forces


def equilibrium(body: ElasticBody, forces: np.ndarray, ramp: int = 1) -> np.ndarray:
    """Equilibrium of a body without support: implicit Euler with steps of 1 s, in which inertia only holds the rigid
    motions. A vibration (150 rad/s at least) shrinks by 1e4 in each of the four steps after the ramp."""
    scene = Scene(body, gravity=(0, 0, 0), loads=Loads(body.mesh.vertices, lambda t: min(t / ramp, 1.0) * forces))
    options = Timing(fps=1.0, steps_per_frame=1, integrator="implicit_euler", tolerance=1e-11)
    return simulate(scene, replace(options, frames=ramp + 5)).positions[-1]


def mean_gradient(mesh: TetMesh, x: np.ndarray) -> np.ndarray:
    """Deformation gradient of the best affine map."""
    rest = mesh.vertices - mesh.vertices.mean(0)
    return np.linalg.lstsq(rest, x - x.mean(0), rcond=None)[0].T


def principal(mesh: TetMesh, x: np.ndarray) -> np.ndarray:
    """Stretches along the axes, whatever rigid rotation the body has taken up."""
    f = mean_gradient(mesh, x)
    return np.sqrt(np.diag(f.T @ f))


# --- small strain: all laws are linear elasticity up to terms of the strain, 1e-4 here


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", sorted(LAWS))
def test_stretched_bar_gives_back_its_constants(law, order):
    mesh = bar(order)
    body = ElasticBody(mesh, law=law, youngs_modulus=E, poisson_ratio=NU)
    strain = principal(mesh, equilibrium(body, pull(mesh, (1e-4 * E, 0, 0)))) - 1
    assert 1e-4 * E / strain[0] == pytest.approx(E, rel=5e-4)
    np.testing.assert_allclose(-strain[1:] / strain[0], NU, rtol=5e-4)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_tension_all_around_gives_back_the_bulk_modulus(law):
    mesh, nu = bar(2), 0.49
    body = ElasticBody(mesh, law=law, youngs_modulus=E, poisson_ratio=nu)
    bulk = E / (3 * (1 - 2 * nu))
    # tension: under pressure by dead loads a free body turns over
    strain = principal(mesh, equilibrium(body, pull(mesh, 1e-4 * bulk * np.ones(3)))) - 1
    np.testing.assert_allclose(strain, 1e-4 / 3, rtol=5e-4)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_clamped_bar_by_the_static_solver(law):
    mesh = box_mesh((0.6, 0.1, 0.1), (10, 2, 2))
    body = ElasticBody(mesh, law=law, youngs_modulus=E, poisson_ratio=NU)
    load = surface_load(mesh, lambda c: np.isclose(c[:, 0], 0.6), (1e-4 * E, 0, 0))
    clamped = NodePins(np.flatnonzero(mesh.vertices[:, 0] == 0))
    x = solve_static(Scene(body, gravity=(0, 0, 0), loads=Loads(mesh.vertices, load), node_pins=clamped))
    u = x - mesh.vertices
    # two widths from either end, where the clamp's disturbance has died out to about exp(−2 × 4) = 3e-4
    left, right = (np.isclose(mesh.vertices[:, 0], at) for at in (0.24, 0.36))
    strain = (u[right, 0].mean() - u[left, 0].mean()) / 0.12
    assert strain == pytest.approx(1e-4, rel=2e-3)
    side = np.polyfit(mesh.vertices[right, 1], u[right, 1], 1)[0]
    assert -side / strain == pytest.approx(NU, rel=2e-3)


@pytest.mark.parametrize("order", [1, 2])
def test_bar_of_two_materials(order):
    # ν/E equal in both halves, so that they contract alike and the exact solution is linear in each half
    mesh = bar(order) if order == 2 else box_mesh(tuple(SIZE), (6, 3, 3), order=1)
    stiff = mesh.vertices[mesh.corner_tets].mean(1)[:, 0] > SIZE[0] / 2
    body = ElasticBody(
        mesh,
        law="linear",
        youngs_modulus=np.where(stiff, 2 * E, E),
        poisson_ratio=np.where(stiff, 0.4, 0.2),
        density=np.where(stiff, 300.0, 2000.0),
    )
    u = equilibrium(body, pull(mesh, (1e-3 * E, 0, 0))) - mesh.vertices
    mid, end = (u[np.isclose(mesh.vertices[:, 0], at), 0] for at in (0.15, 0.3))
    start = u[mesh.vertices[:, 0] == 0, 0]
    np.testing.assert_allclose(mid.mean() - start, 1e-3 * 0.15, rtol=1e-7)
    np.testing.assert_allclose(end - mid.mean(), 0.5e-3 * 0.15, rtol=1e-7)
    width = np.polyfit(mesh.vertices[:, 1], u[:, 1], 1)[0]
    assert width == pytest.approx(-0.2e-3, rel=1e-7)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_hanging_by_its_own_weight(law):
    # ν = 0 makes it one-dimensional: u = ρ g (L s − s²/2)/E at the distance s below the clamp, exact in P2
    mesh = box_mesh((0.1, 0.1, 0.3), (1, 1, 3))
    body = ElasticBody(mesh, law=law, youngs_modulus=1e8, poisson_ratio=0.0, density=1200.0)
    top = NodePins(np.flatnonzero(mesh.vertices[:, 2] == 0.3))
    u = solve_static(Scene(body, gravity=(0, 0, -9.81), node_pins=top)) - mesh.vertices
    s = 0.3 - mesh.vertices[:, 2]
    expected = -1200 * 9.81 * (0.3 * s - s**2 / 2) / 1e8
    # strains of 3.5e-5, and the nonlinear laws differ from the linear one by about that share
    np.testing.assert_allclose(u[:, 2], expected, rtol=1e-4, atol=1e-10)


# --- finite strain


def neo_hookean(f: np.ndarray, mu: float, lam: float) -> np.ndarray:
    """Principal first Piola stresses of principal stretches, Ψ = μ/2 (I₁ − 3) − μ (J − 1) + (λ + μ)/2 (J − 1)²."""
    j = f.prod()
    return mu * f + ((lam + mu) * (j - 1) - mu) * j / f


def neo_hookean_log(f: np.ndarray, mu: float, lam: float) -> np.ndarray:
    """The same of Ψ = μ/2 (I₁ − 3) − μ ln J + λ/2 (ln J)²."""
    return mu * f + (lam * np.log(f.prod()) - mu) / f


def stvk(f: np.ndarray, mu: float, lam: float) -> np.ndarray:
    strain = (f**2 - 1) / 2
    return f * (2 * mu * strain + lam * strain.sum())


def corotated(f: np.ndarray, mu: float, lam: float) -> np.ndarray:
    return 2 * mu * (f - 1) + lam * (f.prod() - 1) * f.prod() / f


CLOSED_FORMS = {"neo_hookean": neo_hookean, "neo_hookean_log": neo_hookean_log, "stvk": stvk, "corotated": corotated}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", sorted(CLOSED_FORMS))
@pytest.mark.parametrize("axes", [1, 2])  # uniaxial, equibiaxial
def test_finite_stretch(law, order, axes):
    stress, stretch = CLOSED_FORMS[law], 1.4 if axes == 1 else 1.2
    mu, lam = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))

    def state(side: float) -> np.ndarray:
        return np.array([stretch, side, side]) if axes == 1 else np.array([stretch, stretch, side])

    # the free sides bear no stress; that fixes their stretch
    expected = state(brentq(lambda side: stress(state(side), mu, lam)[2], 0.6, 1.0, xtol=1e-14))
    tractions = stress(expected, mu, lam) * (np.arange(3) < axes)
    mesh = bar(order)
    body = ElasticBody(mesh, law=law, youngs_modulus=E, poisson_ratio=NU)
    x = equilibrium(body, pull(mesh, tractions), ramp=4)
    np.testing.assert_allclose(principal(mesh, x), expected, rtol=1e-8)
    f = body.deformation_gradient(x).numpy()
    np.testing.assert_allclose(f, np.broadcast_to(mean_gradient(mesh, x), f.shape), atol=1e-7)  # homogeneous


# --- patch test, rotation


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", sorted(LAWS))
def test_patch(law, order):
    """Boundary nodes on an affine map: inner nodes follow it."""
    mesh = bar(order)
    f = np.eye(3) + 0.05 * np.random.default_rng(4).normal(size=(3, 3))
    target = mesh.vertices @ f.T
    boundary = mesh.node_areas > 0
    start = np.where(boundary[:, None], target, target + 0.002)
    body = ElasticBody(mesh, law=law, youngs_modulus=E, poisson_ratio=NU)
    scene = Scene(body, gravity=(0, 0, 0), initial_positions=start, node_pins=NodePins(np.flatnonzero(boundary)))
    np.testing.assert_allclose(solve_static(scene), target, atol=1e-10)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", sorted(set(LAWS) - {"linear"}))
def test_rigid_rotation_has_zero_stress(law, order):
    mesh = bar(order)
    body = ElasticBody(mesh, law=law, youngs_modulus=E, poisson_ratio=0.49)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    x = mesh.vertices @ turn.T + (1.0, 2.0, 3.0)
    assert np.abs(body.stress(x).numpy()).max() < 1e-9 * E
    assert abs(body.energy(x)) < 1e-14 * E * mesh.volume  # rounding of terms of size μ V
    np.testing.assert_allclose(body.gradient(x), 0.0, atol=1e-11 * E)


# --- the solver says when it cannot


def test_body_without_support_is_an_error():
    body = ElasticBody(box_mesh((0.1, 0.1, 0.1), (1, 1, 1)), youngs_modulus=E)
    with pytest.raises(ConvergenceError, match="held by pins or contacts"):
        solve_static(Scene(body))


def test_unreachable_tolerance_is_an_error():
    mesh = box_mesh((0.1, 0.1, 0.1), (1, 1, 1))
    body = ElasticBody(mesh, youngs_modulus=E)
    scene = Scene(body, node_pins=NodePins(np.flatnonzero(mesh.vertices[:, 0] == 0)))
    with pytest.raises(ConvergenceError, match=r"no descent|iterations left"):
        solve_static(scene, tolerance=1e-30)


def test_load_steps_reach_the_same_equilibrium():
    mesh = box_mesh((0.3, 0.05, 0.05), (4, 1, 1))
    body = ElasticBody(mesh, youngs_modulus=5e4, poisson_ratio=0.4)
    scene = Scene(body, node_pins=NodePins(np.flatnonzero(mesh.vertices[:, 0] == 0)))
    once, often = solve_static(scene), solve_static(scene, load_steps=4)
    assert (mesh.vertices - once)[:, 2].max() > 0.05  # it bends a lot
    np.testing.assert_allclose(often, once, atol=1e-8)


def test_bad_number_of_load_steps_is_named():
    body = ElasticBody(box_mesh((0.1, 0.1, 0.1), (1, 1, 1)))
    with pytest.raises(InputError, match="load_steps: got 0"):
        solve_static(Scene(body), load_steps=0)
