"""Contact and friction solved for together on the touching points: the equations hold, impulses obey Coulomb's law."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.sparse import csr_matrix

from physconvex import InputError
from physconvex.dynamics import Contact, Plane, Sphere, State, Timing, Wind, bdf2, simulate
from physconvex.fem import (
    ElasticBody,
    NodalEquations,
    NodePins,
    Scene,
    SurfacePoints,
    compiled_contact as contact_kernel,
    kept_factor,
)
from physconvex.fem.compiled_contact import CompiledContact, add_near, carry, contact_kind, turned_blocks
from physconvex.fem.contact_problem import CarriedPoints, ContactProblem
from physconvex.fem.kept_factor import KeptFactor
from physconvex.mesh import box_mesh
from tests.kernels.missing import MISSING

BOX = (0.2, 0.2, 0.1)
FLOOR = Plane(point=(0, 0, -0.02), friction=0.4)
WALL = Plane(point=(0.21, 0, 0), normal=(-1.0, 0, 0.2), friction=0.7)
BALL = Sphere(center=(0.05, 0.1, -0.33), radius=0.3, friction=0.5, velocity=(0.2, 0, 0))


def thrown(*obstacles, modulus: float = 1e5, **fields) -> Scene:
    body = ElasticBody(box_mesh(BOX, (2, 2, 1)), youngs_modulus=modulus, poisson_ratio=0.35)
    motion = {"initial_velocity": (1.0, 0.3, -2.0), "initial_angular_velocity": (2.0, -3.0, 1.0), "damping_time": 1e-3}
    return Scene(body, obstacles=obstacles, **(motion | fields))


def surface_points() -> SurfacePoints:
    """A grid below the box's bottom, which the box carries."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 0.2, 6), np.linspace(0, 0.2, 6)))
    return SurfacePoints(np.stack([x, y, np.full(36, -0.005)], axis=1), np.full(36, 0.04 / 36))


SCENES = {
    "floor": thrown(FLOOR),
    "stiff": thrown(FLOOR, modulus=3e6),
    "two planes": thrown(FLOOR, WALL),
    "sphere": thrown(BALL),
    "points": thrown(FLOOR, contact_points=surface_points()),
    "wind": thrown(FLOOR, wind=Wind(velocity=(5.0, 0, 0)), air_drag=0.5),
    "pinned": thrown(
        Plane(point=(0, 0, 0.005), friction=0.5, velocity=(0.3, 0, 0)),
        node_pins=NodePins(np.flatnonzero(box_mesh(BOX, (2, 2, 1)).vertices[:, 2] > 0.099)),
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_every_step_ends_where_all_forces_balance(name):
    """The gradient with normal forces and slip of the solution itself vanishes, beside that of contact alone."""
    left, touched = [], []

    def watch(equations, record):
        x, contact = record.after.positions, equations.contact
        push = contact.energy_and_gradient(x, record.after.time)[1]
        if push.any():
            assert equations.freeze_friction(x)
            touched.append(np.abs(push).max())
            left.append(np.abs(equations.gradient(x)).max())

    options = Timing(frames=4, fps=24, steps_per_frame=16, tolerance=1e-9)
    run = simulate(SCENES[name], replace(options, contact_solver="condensed"), observer=watch)
    assert len(touched) > 3
    assert max(left) < 1e-4 * max(touched)
    assert run.statistics.halved_steps == 0


@pytest.mark.parametrize(("friction", "modulus"), [(0.2, 1e6), (0.5, 1e5), (0.5, 1e6), (0.8, 1e6)])
def test_sliding_impact_exchanges_impulses_by_coulombs_law(friction, modulus):
    """As in `test_contact_motion`, where passes leave up to 3 % on either side.

    Never more than μ times the normal impulse, and little less: the body widens, so that not all slip is straight.
    """
    floor = Plane(point=(0, 0, -0.02), friction=friction)
    still = {"gravity": (0, 0, 0), "initial_angular_velocity": (0, 0, 0), "damping_time": 0.0}
    scene = thrown(floor, modulus=modulus, initial_velocity=(5.0, 0, -2.0), **still)
    run = simulate(scene, Timing(frames=2, fps=8, steps_per_frame=50, contact_solver="condensed"))
    masses = scene.body.node_masses / scene.body.total_mass
    start, end = masses @ run.velocities[0], masses @ run.velocities[-1]
    assert end[2] > 0.8 and end[0] > 1.0  # it bounced, and never stuck
    assert 0.98 * friction < (start - end)[0] / (end - start)[2] <= friction * (1 + 1e-6)


def test_one_factor_lasts_through_flight_turn_and_impact():
    options = Timing(frames=6, fps=24, steps_per_frame=16, tolerance=1e-6)
    scene = thrown(FLOOR, modulus=3e6, initial_angular_velocity=(8.0, 0, 4.0))
    kept = simulate(scene, replace(options, contact_solver="condensed")).statistics
    passes = simulate(scene, options).statistics
    assert kept.factorisations == 2  # one for the first step, which is shorter in effect
    assert passes.factorisations > 10 * kept.factorisations
    assert kept.newton_iterations < passes.newton_iterations


def test_refused_where_a_pass_is_needed():
    with pytest.raises(InputError, match="contact_damping"):
        simulate(thrown(FLOOR, contact_damping=1e-3), Timing(contact_solver="condensed"))
    with pytest.raises(InputError, match="expected 'passes' or 'condensed'"):
        simulate(thrown(FLOOR), Timing(contact_solver="penalty"))


# --- the kept factor


@pytest.fixture
def turned():
    """Equations of a step, and where the body lies turned by 40°, a little deformed."""
    scene = thrown(FLOOR)
    equations = NodalEquations(scene)
    x = scene.start
    before, history = State(0.01, x, scene.start_velocities()), State(0.0, x, scene.start_velocities())
    a = np.radians(40)
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    equations.set_step(bdf2(before, history, 0.01), 0.02, x, before)
    return equations, x, x @ turn.T


def test_the_factor_turns_with_the_body(turned):
    equations, x, there = turned
    factor = KeptFactor(equations)
    assert factor.prepare(x, renew=False)
    assert not factor.prepare(there, renew=False)
    equations.viscosity = replace(equations.viscosity, state=equations.body.deformation_gradient(there))
    way = np.random.default_rng(0).normal(size=x.shape)
    change = (equations.smooth_gradient(there + 1e-7 * way) - equations.smooth_gradient(there - 1e-7 * way)) / 2e-7
    np.testing.assert_allclose(-factor.apply(there, change), way, atol=1e-5)


def test_compliance_is_what_forces_on_points_do(turned, monkeypatch):
    equations, x, there = turned
    factor, rng = KeptFactor(equations), np.random.default_rng(1)
    factor.prepare(x, renew=True)
    factor.prepare(there, renew=False)
    place = there.copy()
    for _ in range(4):  # what is learnt from gradients enters both
        place = place + 0.3 * factor.apply(place, equations.smooth_gradient(place))
    for points in (np.array([3, 8]), np.array([1, 8, 20])):  # columns are added
        forces = rng.normal(size=(len(points), 3))
        moved = (factor.compliance(points) @ forces.ravel()).reshape(-1, 3)
        np.testing.assert_allclose(factor.pushed(points, forces)[points], moved, rtol=1e-9)
        monkeypatch.setattr(kept_factor, "_MOST_ROWS", 0)  # those of many nodes are solved for anew
        factor.pushed(np.arange(len(x)), np.zeros_like(x))


def test_what_is_learnt_obeys_the_secant_equation(turned):
    """Of the last two gradients met: the change of place is H times the change of gradient."""
    equations, x, there = turned
    factor, rng = KeptFactor(equations), np.random.default_rng(2)
    factor.prepare(x, renew=True)
    factor.prepare(there, renew=False)
    places = there + 0.005 * rng.normal(size=(20, *x.shape))  # more than are kept
    gradients = [equations.smooth_gradient(place) for place in places]
    for place, gradient in zip(places, gradients, strict=True):
        factor.apply(place, gradient)
    moved = factor.pushed(np.arange(len(there)), gradients[-1] - gradients[-2])
    np.testing.assert_allclose(moved, places[-1] - places[-2], atol=1e-12)
    assert equations.factorisations == 1


# --- the equation of the forces


@pytest.fixture(params=["compiled", "numpy"])
def kind(request, monkeypatch):
    """Both arithmetics; without a compiler numpy's is taken."""
    if request.param == "numpy":
        monkeypatch.setattr(contact_kernel, "FEM_KERNEL", MISSING)
    return CompiledContact if request.param == "compiled" else ContactProblem


def problem_of(points: int, nodes: int, obstacles=(FLOOR,)) -> tuple[ContactProblem, np.ndarray]:
    """Points on some nodes, about half of them in the floor, and forces, each point before each obstacle."""
    rng = np.random.default_rng(3)
    carried = csr_matrix(np.where(rng.random((points, nodes)) < 0.5, rng.random((points, nodes)), 0.0))
    root = rng.normal(size=(3 * nodes, 3 * nodes))
    compliance = 1e-5 * (root @ root.T + np.eye(3 * nodes))
    law = Contact(obstacles, np.full(points, 1e-3), stiffness=1e6, smoothing=1e-4, slip_velocity=1e-3)
    of_pair, obstacle = np.tile(np.arange(points), len(obstacles)), np.repeat(np.arange(len(obstacles)), points)
    free = (np.array([0, 0, -0.022]) + rng.normal(scale=0.01, size=(points, 3)))[of_pair]
    base = free - rng.normal(scale=1e-3, size=free.shape)
    at = CarriedPoints(free, base, carried[of_pair], compliance, step=1e-3, time=0.01)
    problem = contact_kind()(law, of_pair, obstacle, at)
    return problem, rng.normal(scale=0.1, size=free.shape)


@pytest.mark.parametrize(("points", "nodes"), [(40, 5), (12, 30)])  # more points than nodes, and fewer
def test_the_step_of_the_forces_is_that_of_the_dense_equation(points, nodes, kind):
    """Whatever touches, sticks or slips."""
    problem, forces = problem_of(points, nodes)
    assert type(problem) is kind
    left, slope = problem.residual(forces)
    assert points / 8 < slope.any(axis=(1, 2)).sum() < 7 * points / 8
    matrix = np.kron(problem.carried.toarray(), np.eye(3))
    give = np.diag(np.repeat(1 / problem.stiffness, 3))
    dense = np.eye(3 * points) - block_diag(*slope) @ (give - matrix @ problem.compliance @ matrix.T)
    expected = np.linalg.solve(dense, -left.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(problem.newton_step(left, slope), expected, rtol=1e-7, atol=1e-9)


def test_compiled_numbers_are_those_of_numpy():
    """Of planes and spheres that move, in the same equation."""
    belt = Plane(normal=(-1.0, 0, 0.2), friction=0.7, velocity=(0, 0.5, 0))
    ball = Sphere(center=(0, 0.01, -0.33), radius=0.308, friction=0.5, velocity=(0.2, 0, 0))
    compiled, forces = problem_of(40, 8, obstacles=(FLOOR, belt, ball))
    at = CarriedPoints(
        compiled.free, compiled.base, compiled.carried, compiled.compliance, compiled.step, compiled.time
    )
    plain = ContactProblem(compiled.law, np.tile(np.arange(40), 3), compiled.obstacles, at)
    assert type(compiled) is CompiledContact
    np.testing.assert_allclose(compiled.stiffness, plain.stiffness, rtol=1e-12)
    (left, slope), (expected, expected_slope) = (problem.residual(forces) for problem in (compiled, plain))
    for number in range(3):
        assert expected_slope[compiled.obstacles == number].any()
    np.testing.assert_allclose(left, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(slope, expected_slope, rtol=0, atol=1e-12 * np.abs(expected_slope).max())
    expected = plain.newton_step(left, slope)
    np.testing.assert_allclose(compiled.newton_step(left, slope), expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_points_that_touch_before_or_after_are_near(kind):
    rng = np.random.default_rng(6)
    law = Contact((FLOOR, BALL), np.where(rng.random(60) < 0.7, 1e-3, 0.0), 1e6, smoothing=1e-4, slip_velocity=1e-3)
    x, moved = (0.03 * rng.normal(size=(60, 3)) + (0.05, 0.1, -0.02) for _ in range(2))
    near = np.zeros((2, 60), dtype=bool)
    near[0, 7] = True  # kept
    add_near(law, x, moved, 0.1, near)
    for obstacle, found in zip((FLOOR, BALL), near, strict=True):
        inside = [(obstacle.gap(at, 0.1) < 0) & (law.areas > 0) for at in (x, moved)]
        assert all(5 < part.sum() < 55 for part in inside)
        assert (found == inside[0] | inside[1] | ((np.arange(60) == 7) & (obstacle is FLOOR))).all()


def test_blocks_turn_with_the_body_and_points_are_carried(kind):
    rng = np.random.default_rng(5)
    matrix, more = (root + root.T for root in (rng.normal(size=(30, 30)), rng.normal(size=(12, 12))))
    places, turn = np.array([7, 0, 3, 9]), np.asfortranarray(np.linalg.qr(rng.normal(size=(3, 3)))[0])
    dofs = (3 * places[:, None] + np.arange(3)).ravel()
    whole = np.kron(np.eye(4), turn)
    part = matrix[np.ix_(dofs, dofs)]
    np.testing.assert_allclose(turned_blocks(matrix, places, turn), whole @ part @ whole.T, atol=1e-12)
    np.testing.assert_allclose(turned_blocks(matrix, places, turn, more), whole @ (part + more) @ whole.T, atol=1e-12)
    carried, x = csr_matrix(rng.random((9, 5))), rng.normal(size=(5, 3))
    np.testing.assert_allclose(carry(carried, x), carried @ x, rtol=1e-12)


def test_bodies_move_alike_without_a_compiler(monkeypatch):
    options = Timing(frames=3, fps=24, steps_per_frame=12, contact_solver="condensed")
    compiled = simulate(SCENES["points"], options)
    monkeypatch.setattr(contact_kernel, "FEM_KERNEL", MISSING)
    plain = simulate(SCENES["points"], options)
    assert np.abs(plain.positions[-1] - plain.positions[0]).max() > 0.05
    np.testing.assert_allclose(compiled.positions, plain.positions, atol=1e-7)
