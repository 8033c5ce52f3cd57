"""The function that a time step minimises: its gradient and Hessian by finite differences, everything switched on."""

import numpy as np
import pytest
import scipy.sparse as sp

from physconvex.dynamics import Loads, Plane, Sphere, State, bdf2, implicit_euler
from physconvex.fem import ElasticBody, NodalEquations, NodePins, Scene
from physconvex.materials import LAWS, StepViscosity
from physconvex.mesh import box_mesh

E = 1e4
STEP = 1e-6  # m on a body of 0.3 m: central differences err by about 1e-10 relatively


def body_of(order: int, law: str = "neo_hookean", **constants) -> ElasticBody:
    mesh = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=order)
    rng = np.random.default_rng(5)
    count = len(mesh.tets)
    heterogeneous = {
        "youngs_modulus": E * rng.uniform(0.5, 3.0, count),
        "poisson_ratio": rng.uniform(0.2, 0.49, count),
        "density": rng.uniform(500, 2000, count),
    }
    return ElasticBody(mesh, law=law, **(heterogeneous | constants))


def shaken(body: ElasticBody, seed: int, amount: float = 0.005) -> np.ndarray:
    return body.mesh.vertices + amount * np.random.default_rng(seed).normal(size=body.mesh.vertices.shape)


def derivative(function, x: np.ndarray, direction: np.ndarray):
    return (function(x + STEP * direction) - function(x - STEP * direction)) / (2 * STEP)


def directions(shape, count: int = 4, seed: int = 9) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, *shape))


# --- the body alone


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", sorted(LAWS))
def test_elastic_force_is_the_derivative_of_the_energy(law, order):
    body = body_of(order, law)
    x = shaken(body, 1)
    gradient = body.gradient(x)
    for d in directions(x.shape):
        expected = derivative(body.energy, x, d)
        np.testing.assert_allclose((gradient * d).sum(), expected, rtol=1e-6, atol=1e-6 * np.abs(gradient).sum())
    energy, again = body.energy_and_gradient(x)
    assert energy == pytest.approx(body.energy(x))
    np.testing.assert_array_equal(again, gradient)


def assembled_product(body: ElasticBody, x: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Stiffness times a direction, assembled here independently of `Assembler`."""
    local = body.element_hessians(x)
    tets = body.mesh.tets
    parts = np.einsum("emn,en->em", local, d[tets].reshape(len(tets), -1)).reshape(len(tets), -1, 3)
    out = np.zeros_like(d)
    np.add.at(out, tets, parts)
    return out


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", sorted(LAWS))
def test_stiffness_is_the_derivative_of_the_force(law, order):
    body = body_of(order, law)
    x = shaken(body, 2)
    for d in directions(x.shape):
        expected = derivative(body.gradient, x, d)
        np.testing.assert_allclose(assembled_product(body, x, d), expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("order", [1, 2])
def test_projected_element_matrices_are_positive_and_near_rest_exact(order):
    body = body_of(order, "neo_hookean")
    local = body.element_hessians(shaken(body, 3, 0.02), project=True)
    assert np.linalg.eigvalsh(local).min() > -1e-9 * np.abs(local).max()
    rest = body.mesh.vertices
    exact, projected = body.element_hessians(rest), body.element_hessians(rest, project=True)
    np.testing.assert_allclose(projected, exact, atol=1e-10 * np.abs(exact).max())


def test_viscous_force_and_matrix():
    body = body_of(2)
    state = body.deformation_gradient(shaken(body, 4))
    v, time = directions(body.mesh.vertices.shape, 1)[0], 0.02
    _, force = body.viscous_energy_and_gradient(state, v, time)
    for d in directions(v.shape):
        slope = derivative(lambda u: body.viscous_energy_and_gradient(state, u, time)[0], v, d)
        np.testing.assert_allclose((force * d).sum(), slope, rtol=1e-6, atol=1e-7 * np.abs(force).sum())
    with_viscosity = body.element_hessians(body.mesh.vertices, viscosity=StepViscosity(state, time, 1.0))
    local = with_viscosity - body.element_hessians(body.mesh.vertices)
    tets = body.mesh.tets
    power = np.einsum("em,emn,en->", v[tets].reshape(len(tets), -1), local, v[tets].reshape(len(tets), -1))
    assert 0.5 * power == pytest.approx(body.viscous_energy_and_gradient(state, v, time)[0], rel=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_viscosity_feels_no_rigid_motion(order):
    body = body_of(order)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    x = body.mesh.vertices @ turn.T
    rigid = np.array([0.3, -1.0, 2.0]) + np.cross([1.0, -2.0, 0.5], x)
    power, force = body.viscous_energy_and_gradient(body.deformation_gradient(x), rigid, 0.1)
    assert power < 1e-20 * E
    np.testing.assert_allclose(force, 0.0, atol=1e-12 * E)


# --- the whole incremental potential


def full_scene(order: int, *, sphere: bool = False, pins: bool = True) -> Scene:
    body = body_of(order)
    obstacles = [Plane(point=(0.1, 0, 0.01), normal=(-0.1, 0.0, 1.0), friction=0.5, velocity=(0.2, 0.0, 0.0))]
    if sphere:
        obstacles.append(Sphere(center=(0.33, 0.0, 0.05), radius=0.06, friction=0.2))
    return Scene(
        body,
        obstacles=tuple(obstacles),
        damping_time=0.01,
        air_drag=0.7,
        node_pins=NodePins(np.flatnonzero(body.mesh.vertices[:, 0] == 0)) if pins else None,
        loads=Loads(body.mesh.vertices, lambda t: np.full(body.mesh.vertices.shape, 0.01 * (1 + t))),
        contact_smoothing=0.02,
        slip_velocity=0.3,
    )


def step_equations(scene: Scene, *, two_step: bool) -> tuple[NodalEquations, np.ndarray]:
    """Equations of one time step between random states, and a random point to look at (pins respected)."""
    equations, body, rng = NodalEquations(scene), scene.body, np.random.default_rng(3)
    states = [State(0.0, shaken(body, s, 0.004), 0.3 * rng.normal(size=body.mesh.vertices.shape)) for s in (1, 2)]
    coefficients = bdf2(states[1], states[0], 0.01) if two_step else implicit_euler(states[1], 0.01)
    x = shaken(body, 7, 0.002)
    equations.set_step(coefficients, 0.01, shaken(body, 8, 0.004), states[1])
    return equations, x


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("two_step", [False, True])
def test_gradient_of_the_incremental_potential(order, two_step):
    scene = full_scene(order, sphere=True)
    equations, x = step_equations(scene, two_step=two_step)
    # everything is switched on, also at nodes that move
    assert equations.viscosity is not None and len(equations.friction) == 2
    assert all(scene.free_nodes()[part.nodes].any() for part in equations.friction)
    free = scene.free_nodes()[:, None]
    _, gradient = equations.evaluate(x)
    np.testing.assert_array_equal(gradient[~free[:, 0]], 0.0)
    for d in directions(x.shape) * free:
        expected = derivative(lambda y: equations.evaluate(y)[0], x, d)
        np.testing.assert_allclose((gradient * d).sum(), expected, rtol=1e-6)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("pins", [True, False])
def test_factorised_matrix_is_the_derivative_of_the_gradient(order, pins):
    scene = full_scene(order, pins=pins)
    equations, x = step_equations(scene, two_step=True)
    equations.factorise(x, project=False)
    free = scene.free_nodes()[:, None]
    for d in directions(x.shape) * free:
        change = derivative(lambda y: equations.evaluate(y)[1], x, d)
        np.testing.assert_allclose(equations.solve(change), d, atol=1e-6 * np.abs(d).max())


def test_static_matrix_is_the_derivative_of_the_gradient():
    scene = full_scene(2)
    equations = NodalEquations(scene)
    x = shaken(scene.body, 7, 0.00002)  # near rest: definite without inertia
    equations.factorise(x, project=False)
    d = directions(x.shape, 1)[0] * scene.free_nodes()[:, None]
    change = derivative(lambda y: equations.evaluate(y)[1], x, d)
    np.testing.assert_allclose(equations.solve(change), d, atol=1e-5 * np.abs(d).max())


def test_assembled_pattern_matches_a_plain_assembly():
    scene = full_scene(2)
    equations, x = step_equations(scene, two_step=True)
    local = scene.body.element_hessians(x)
    data = equations.assembler.elements(local)
    upper = equations.assembler.pattern.copy()
    upper.data = data
    matrix = upper + sp.triu(upper, 1).T
    free = scene.free_nodes()
    d = directions(x.shape, 1)[0] * free[:, None]
    expected = assembled_product(scene.body, x, d)[free].ravel()
    np.testing.assert_allclose(matrix @ d[free].ravel(), expected, atol=1e-10 * np.abs(expected).max())


# --- mass


@pytest.mark.parametrize("order", [1, 2])
def test_mass_of_a_heterogeneous_body(order):
    body = body_of(order)
    assert body.mass.sum() == pytest.approx(body.total_mass)
    assert body.total_mass == pytest.approx((body.density * body.mesh.element_volumes).sum())
    # kinetic energy of a rotation about z: ½ ω² ∫ ρ (x² + y²), by a fine midpoint rule over each tetrahedron
    spin = np.cross([0.0, 0.0, 2.0], body.mesh.vertices)
    kinetic = 0.5 * (spin * (body.mass @ spin)).sum()
    corners = body.mesh.vertices[body.mesh.corner_tets]
    # exact second moment of a tetrahedron: V/20 (Σ x_i² + (Σ x_i)²)
    moment = (corners**2).sum(1) + corners.sum(1) ** 2
    expected = 0.5 * 4.0 * (body.density * body.mesh.element_volumes / 20 * moment[:, :2].sum(1)).sum()
    assert kinetic == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_particles_carry_equal_masses(order):
    mesh = body_of(order).mesh.with_equal_masses()
    body = ElasticBody(mesh, density=1200.0)
    share = body.total_mass / len(mesh.vertices)
    np.testing.assert_allclose(body.mass.toarray(), share * np.eye(len(mesh.vertices)), rtol=1e-12)
    np.testing.assert_allclose(body.node_masses, share)
    # a step of free fall from rest moves all nodes alike, by g h² of implicit Euler
    scene, still = Scene(body), State(0.0, mesh.vertices, np.zeros_like(mesh.vertices))
    equations = NodalEquations(scene)
    equations.set_step(implicit_euler(still, 0.01), 0.01, mesh.vertices, still)
    fallen = mesh.vertices + 0.01**2 * np.asarray(scene.gravity)
    np.testing.assert_allclose(equations.gradient(fallen), 0.0, atol=1e-9 * body.total_mass)


def test_quadratic_mass_integrates_quartic_products_exactly():
    body = ElasticBody(box_mesh((1.0, 1.0, 1.0), (1, 1, 1)), density=3.0)
    x = body.mesh.vertices[:, 0]
    # x² lies in P2, so ∫ ρ x⁴ = 3/5 must come out to rounding
    assert x**2 @ body.mass @ x**2 == pytest.approx(3 / 5, rel=1e-9)
