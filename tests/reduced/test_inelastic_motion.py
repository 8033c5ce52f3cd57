"""Reduced bodies that flow: what stays, what relaxes, what slumps; and the step's derivatives."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from physconvex.dynamics import Pins, Plane, State, Timing, implicit_euler, simulate
from physconvex.fem import ElasticBody
from physconvex.materials import Plasticine, Sand, StandardLinearSolid, with_fibres
from physconvex.mesh import box_mesh, tetrahedralize
from physconvex.reduced import (
    BodySamples,
    ReducedBody,
    ReducedEquations,
    ReducedScene,
    ReducedSpace,
    eigenmode_weights,
)

SIZE = (0.3, 0.2, 0.1)
MODULUS = 2e4
SLOW = Timing(steps_per_frame=4, integrator="implicit_euler", tolerance=1e-8)


def stretched(body: ReducedBody, path, across=lambda t: 0.0) -> tuple[ReducedScene, np.ndarray]:
    """A bar whose end faces are led apart by the strain path(t) and narrowed by across(t); their rest positions."""
    samples = body.space.samples
    ends = [samples.surface_points[np.isclose(samples.surface_points[:, 0], x)] for x in (0.0, SIZE[0])]
    faces, middle = np.vstack(ends), 0.5 * np.array(SIZE)
    areas = np.concatenate([np.full(len(e), SIZE[1] * SIZE[2] / len(e)) for e in ends])

    def motion(t: float) -> np.ndarray:
        return faces + (faces - middle) * [path(t), across(t), across(t)]

    return ReducedScene(body, pins=Pins(faces, areas, motion), gravity=(0, 0, 0)), faces


def end_force(scene: ReducedScene, run, frame: int) -> float:
    """How hard the right end is pulled [N]."""
    springs = scene.pin_springs()
    pull = springs.pull(run.coordinates[frame], run.times[frame])[:, 0]
    return float(pull[springs.anchors[:, 0] > 0.5 * SIZE[0]].sum())


def test_a_bar_stretched_beyond_yield_keeps_a_set_and_an_elastic_one_does_not(space_of):
    """Pulled to a strain of 8 % and let go to 6 %: with τ_Y/E = 2 %, that is where the force is gone (ν = 0)."""
    yield_stress, area = 400.0, SIZE[1] * SIZE[2]

    def along(t: float) -> float:
        return float(np.expm1(0.08 * t if t <= 1 else 0.08 - 0.02 * (t - 1)))

    def across(t: float) -> float:  # flow keeps the volume: the ends follow the bar
        return float(np.expm1(-0.5 * max(0.08 * min(t, 1.0) - 0.02, 0.0)))

    body = ReducedBody(space_of(), youngs_modulus=MODULUS, poisson_ratio=0.0, flow=Plasticine(yield_stress))
    scene, _ = stretched(body, along, across)
    run = simulate(scene, replace(SLOW, frames=3, fps=1))
    # Kirchhoff stress τ_Y: force × stretch = τ_Y × area at rest
    assert end_force(scene, run, 1) * np.exp(0.08) == pytest.approx(yield_stress * area, rel=0.01)
    assert abs(end_force(scene, run, 2)) < 0.02 * yield_stress * area
    flowed = np.log(np.linalg.svd(run.flowed[-1])[1])
    np.testing.assert_allclose(flowed, np.tile([0.06, -0.03, -0.03], (len(flowed), 1)), atol=1e-3)
    np.testing.assert_allclose(np.linalg.det(run.flowed[-1]), 1.0, atol=1e-9)
    elastic, _ = stretched(ReducedBody(space_of(), youngs_modulus=MODULUS, poisson_ratio=0.0), along)
    spring = simulate(elastic, replace(SLOW, frames=3, fps=1))
    assert spring.flowed is None and end_force(elastic, spring, 2) > 0.9 * 0.06 * MODULUS * area


def test_a_dent_of_an_impact_stays(space_of):
    """Thrown at a floor: plasticine comes off flatter and stays so, an elastic body recovers its height."""
    heights, flowed = {}, None
    for name, flow in {"elastic": None, "plasticine": Plasticine(300.0)}.items():
        body = ReducedBody(space_of(), youngs_modulus=MODULUS, poisson_ratio=0.3, flow=flow)
        scene = ReducedScene(
            body, obstacles=(Plane(),), gravity=(0, 0, 0), initial_velocity=(0, 0, -1.0), damping_time=0.02
        )
        run = simulate(scene, Timing(frames=5, fps=8, steps_per_frame=16, tolerance=1e-6))
        mean = body.deformation_gradient(run.coordinates[-1]).numpy().mean(0)
        # stretch of the rest height, whichever way the body has turned
        heights[name], flowed = np.linalg.norm(mean[:, 2]), run.flowed
    assert heights["elastic"] == pytest.approx(1.0, abs=0.01) and heights["plasticine"] < 0.97, heights
    assert flowed is not None
    np.testing.assert_array_equal(flowed[0], np.broadcast_to(np.eye(3), flowed[0].shape))
    assert np.abs(flowed[-1] - np.eye(3)).max() > 0.03
    np.testing.assert_allclose(flowed[-1], flowed[-2], atol=1e-3)  # no flow after the impact


def test_a_standard_linear_solid_relaxes_to_its_slow_modulus(space_of):
    """Held at a strain: E ε A (1 + ratio exp(−t/τ)), ν = 0 and deviatoric share 2/3 of the uniaxial stress."""
    ratio, tau, strain = 2.0, 0.5, 0.01
    body = ReducedBody(space_of(), youngs_modulus=MODULUS, poisson_ratio=0.0, flow=StandardLinearSolid(ratio, tau))
    scene, _ = stretched(body, lambda t: strain)
    run = simulate(scene, replace(SLOW, steps_per_frame=6, frames=4, fps=4))
    forces = np.array([end_force(scene, run, k) for k in (1, 2, 3)])
    slow = strain * MODULUS * SIZE[1] * SIZE[2]
    excess = forces / slow - 1
    decay = np.log(excess[:-1] / excess[1:])
    # the sides follow: with ν = 0 the element would like to keep its volume, so that its share is not exactly 2/3
    np.testing.assert_allclose(decay, 0.25 / tau, rtol=0.12)
    assert excess[0] == pytest.approx(ratio * np.exp(-0.25 / tau) * 2 / 3, rel=0.3)


def test_fibres_make_a_bar_stiffer_along_than_across(space_of):
    force = []
    for direction in ((1, 0, 0), (0, 1, 0)):
        law = with_fibres("neo_hookean", direction, 4.0)
        body = ReducedBody(space_of(), law=law, youngs_modulus=MODULUS, poisson_ratio=0.0)
        scene, _ = stretched(body, lambda t: 0.005)
        force.append(end_force(scene, simulate(scene, replace(SLOW, frames=2, fps=1)), 1))
    expected = 0.005 * MODULUS * SIZE[1] * SIZE[2]
    # k = 4 μ = 2 E for ν = 0: three times as stiff along; across as without
    assert force[0] == pytest.approx(3 * expected, rel=0.03) and force[1] == pytest.approx(expected, rel=0.03)


def test_sand_slumps_where_an_elastic_block_stands(space_of):
    heights = {}
    for name, flow in {"elastic": None, "sand": Sand(np.radians(10.0))}.items():
        body = ReducedBody(space_of(2, 3), youngs_modulus=5e4, poisson_ratio=0.3, flow=flow)
        scene = ReducedScene(body, obstacles=(Plane(friction=0.4),), damping_time=2e-3)
        run = simulate(scene, Timing(frames=4, fps=16, steps_per_frame=8, tolerance=1e-6))
        moved = run.positions(body.space.samples.surface_points)[-1]
        heights[name] = np.ptp(moved[:, 2])
        assert np.isfinite(moved).all()
    assert heights["elastic"] > 0.095 and heights["sand"] < 0.97 * heights["elastic"]


def test_layer_of_sand_rests_below_its_angle_of_repose_and_slides_above():
    """A wide layer on a rough slope in simple shear, where all normal stresses become equal.

    Drucker–Prager then gives way at tan α = 2 √3 sin φ/(3 − sin φ). Above, with a velocity linear in the height, the
    centre of mass is accelerated by ¾ g (sin α − tan α_c cos α), by virtual work.
    """
    mesh = box_mesh((1.0, 1.0, 0.1), (3, 3, 1), order=2)
    space = ReducedSpace(eigenmode_weights(ElasticBody(mesh), 1), BodySamples.of_mesh(mesh))
    sine = np.sin(np.radians(30.0))
    slope = 2 * np.sqrt(3) * sine / (3 - sine)
    body = ReducedBody(space, youngs_modulus=2e5, poisson_ratio=0.3, flow=Sand(np.radians(30.0)))
    speeds = {}
    for excess in (-4.0, 10.0):
        angle = np.arctan(slope) + np.radians(excess)
        gravity = (9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle))
        scene = ReducedScene(body, obstacles=(Plane(friction=3.0),), gravity=gravity)
        run = simulate(scene, Timing(frames=9, fps=40, steps_per_frame=4, tolerance=1e-6))
        speeds[excess] = body.first_moments @ run.velocities[:, :, 0].T / body.total_mass
    assert abs(speeds[-4.0][-1]) < 0.005  # 9.81 sin α × 0.2 s would be 1 m/s
    expected = 0.75 * 9.81 * (np.sin(angle) - slope * np.cos(angle))
    assert (speeds[10.0][-1] - speeds[10.0][3]) / (5 / 40) == pytest.approx(expected, rel=0.1)


def test_a_column_of_sand_becomes_a_heap_that_rests():
    radius = 0.1
    column = trimesh.creation.cylinder(radius=radius, height=radius, sections=16)
    vertices = np.asarray(column.vertices) + np.array([0.0, 0.0, 0.5 * radius])
    mesh = tetrahedralize((vertices, np.asarray(column.faces)), order=2, max_nodes=400, method="auto")
    space = ReducedSpace(eigenmode_weights(ElasticBody(mesh), 12), BodySamples.of_mesh(mesh))
    body = ReducedBody(space, youngs_modulus=1e5, poisson_ratio=0.3, flow=Sand(np.radians(30.0)))
    scene = ReducedScene(body, obstacles=(Plane(friction=1.0),))
    run = simulate(scene, Timing(frames=16, fps=24, steps_per_frame=8, tolerance=1e-6))
    positions = run.positions(mesh.vertices)
    speeds = np.linalg.norm(np.diff(positions, axis=0), axis=2).max(axis=1) * 24
    assert speeds.max() > 0.5 and speeds[-1] < 0.1 * speeds.max()
    last = positions[-1]
    distance = np.linalg.norm(last[:, :2] - last[:, :2].mean(axis=0), axis=1)
    top, rim = last[distance < radius, 2].max(), last[distance > 0.9 * distance.max(), 2].max()
    assert 0.5 * radius < top < 0.9 * radius and rim < 0.3 * top
    assert 0.5 * radius < np.quantile(distance, 0.95) - radius < 2 * radius  # of real grains: 1.24


@pytest.mark.parametrize("flow", [Plasticine(500.0), Sand(0.4), StandardLinearSolid(1.5, 0.02)])
def test_gradient_and_hessian_of_a_step_that_flows(space_of, flow):
    body, rng = ReducedBody(space_of(), youngs_modulus=MODULUS, flow=flow), np.random.default_rng(3)
    equations = ReducedEquations(ReducedScene(body))

    def shaken(amount: float) -> np.ndarray:
        return body.rest * 0.98 + amount * rng.normal(size=body.rest.shape)

    first = State(0.0, shaken(0.004), np.zeros_like(body.rest))
    equations.set_step(implicit_euler(first, 0.01), 0.01, first.positions, first)
    equations.commit(shaken(0.004))
    assert np.abs(equations.flowed() - np.eye(3)).max() > 1e-3
    equations.set_step(implicit_euler(first, 0.01), 0.02, first.positions, State(0.01, first.positions, 0 * body.rest))
    y, step = shaken(0.002), 1e-7
    _, gradient = equations.evaluate(y)
    hessian = equations.hessian(y)
    for d in rng.normal(size=(3, *y.shape)):
        ahead, behind = equations.evaluate(y + step * d), equations.evaluate(y - step * d)
        assert (gradient * d).sum() == pytest.approx((ahead[0] - behind[0]) / (2 * step), rel=1e-5, abs=1e-6)
        change = (ahead[1] - behind[1]) / (2 * step)
        np.testing.assert_allclose(hessian @ d.ravel(), change.ravel(), atol=1e-4 * np.abs(change).max())
