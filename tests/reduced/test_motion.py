"""Motion of reduced bodies: closed forms, contact and friction, and the full-order model."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from physconvex import ConvergenceError, InputError
from physconvex.dynamics import Loads, Plane, Sphere, State, Timing, simulate
from physconvex.fem import ElasticBody, Scene, surface_load
from physconvex.materials import LAWS
from physconvex.mesh import box_mesh
from physconvex.reduced import (
    BodySamples,
    CallableWeights,
    ReducedBody,
    ReducedEquations,
    ReducedScene,
    ReducedSpace,
    ReducedTrajectory,
    eigenmode_weights,
)

G = 9.81
SIZE = (0.3, 0.2, 0.1)


def mean_velocity(body: ReducedBody, run) -> np.ndarray:
    return np.einsum("r,tri->ti", body.first_moments, run.velocities) / body.total_mass


# --- without contact


def test_rest_stays_at_rest(mixed_body):
    run = simulate(ReducedScene(mixed_body(), gravity=(0, 0, 0)), Timing(frames=3))
    np.testing.assert_allclose(run.coordinates, np.broadcast_to(run.coordinates[0], run.coordinates.shape), atol=1e-9)


@pytest.mark.parametrize("integrator", ["bdf2", "implicit_euler"])
def test_free_fall(mixed_body, integrator):
    body = mixed_body()
    scene = ReducedScene(body, gravity=(0.5, 0, -G), initial_velocity=(0.2, -0.1, 1.0))
    run = simulate(scene, Timing(frames=5, steps_per_frame=8, integrator=integrator))
    points = np.random.default_rng(0).uniform(size=(6, 3)) * SIZE
    t, a = run.times[:, None], np.array([0.5, 0, -G])
    h = 1 / (24 * 8)
    # implicit Euler is a h t/2 ahead; BDF2 only by its first step, which is implicit Euler: constant after two steps
    fall = [0.2, -0.1, 1.0] * t + 0.5 * a * t**2 + (0.5 * a * h * t if integrator == "implicit_euler" else 0)
    moved = run.positions(points) - points
    np.testing.assert_allclose(moved, np.repeat(fall[:, None], 6, axis=1), atol=0.75 * G * h * h)
    np.testing.assert_allclose(mean_velocity(body, run), [0.2, -0.1, 1.0] + a * t, atol=1e-7)


def test_a_stiff_body_rotates_rigidly(space_of):
    body = ReducedBody(space_of(), youngs_modulus=1e7)
    spin = np.array([0.0, 0.0, 2.0])  # about a principal axis
    run = simulate(
        ReducedScene(body, gravity=(0, 0, 0), initial_angular_velocity=spin),
        Timing(frames=4, fps=10, steps_per_frame=40),
    )
    center = np.array(SIZE) / 2
    points = np.random.default_rng(0).uniform(size=(6, 3)) * SIZE
    for t, x in zip(run.times, run.positions(points), strict=True):
        c, s = np.cos(2 * t), np.sin(2 * t)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        # BDF2's error of the angle, (ω h)² ω t/3 ~ 1e-5, and the stretch ρ ω² L²/E ~ 1e-5
        np.testing.assert_allclose(x, (points - center) @ turn.T + center, atol=3e-5)


def test_bdf2_is_of_second_order_and_implicit_euler_of_first(mixed_body):
    body = mixed_body(2, youngs_modulus=1e4, poisson_ratio=0.3, density=1000.0)
    squeezed = body.space.affine(np.diag([0.97, 1.0, 1.0]), np.zeros(3))
    scene = ReducedScene(body, gravity=(0, 0, 0), initial_coordinates=squeezed)

    def end(integrator, steps):
        return simulate(
            scene, Timing(frames=2, fps=100, steps_per_frame=steps, integrator=integrator, tolerance=1e-10)
        ).coordinates[-1]

    exact = end("bdf2", 160)
    for integrator, rate in (("bdf2", 2), ("implicit_euler", 1)):
        errors = [np.abs(end(integrator, n) - exact).max() for n in (10, 20)]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(rate, abs=0.35), errors


@pytest.mark.parametrize("law", sorted(LAWS))
def test_a_pulled_bar_settles_at_the_stretch_of_its_constants(space_of, law):
    """End tractions σ: strains σ/E along and −ν σ/E across, by steps of implicit Euler that are nearly static."""
    modulus, poisson, strain = 2e5, 0.37, 1e-4
    mesh = box_mesh(SIZE, (2, 1, 1))
    # linear weights times X are quadratic on a face, for which the nodal loads of quadratic faces are exact
    space = ReducedSpace(space_of(1).field, BodySamples.of_mesh(mesh))
    body = ReducedBody(space, law=law, youngs_modulus=modulus, poisson_ratio=poisson)
    boundary = mesh.node_areas > 0
    pull = [surface_load(mesh, lambda c, e=e: np.isclose(c[:, 0], e), (modulus * strain, 0, 0)) for e in (0, SIZE[0])]
    scene = ReducedScene(body, gravity=(0, 0, 0), loads=Loads(mesh.vertices[boundary], (pull[1] - pull[0])[boundary]))
    run = simulate(scene, Timing(frames=2, fps=0.2, steps_per_frame=5, integrator="implicit_euler", tolerance=1e-10))
    low, high = run.positions(np.array([[0.05, 0.05, 0.02], [0.25, 0.15, 0.08]]))[-1]
    measured = (high - low) / [0.2, 0.1, 0.06] - 1
    np.testing.assert_allclose(measured, strain * np.array([1, -poisson, -poisson]), rtol=1e-3, atol=1e-3 * strain)


# --- contact


def slab(space_of, **constants) -> ReducedBody:
    return ReducedBody(space_of(2, 3), **({"youngs_modulus": 2e5, "poisson_ratio": 0.3} | constants))


def test_resting_body_carries_its_weight(space_of):
    body = slab(space_of)
    scene = ReducedScene(body, obstacles=(Plane(),))
    run = simulate(scene, Timing(frames=2, fps=0.1, steps_per_frame=60, integrator="implicit_euler", tolerance=1e-10))
    contact = scene.contact()
    _, push = contact.energy_and_gradient(body.space.surface_values @ run.coordinates[-1], 0.0)
    np.testing.assert_allclose(push.sum(0), [0, 0, -body.total_mass * G], atol=1e-4 * body.total_mass * G)


@pytest.mark.parametrize(("angle", "friction"), [(20, 0.5), (40, 0.5), (20, 0.0)])
def test_slope_with_friction(space_of, angle, friction):
    """Sticks below the friction angle (26.6°), slides above with g (sin − μ cos)."""
    a, body = np.radians(angle), slab(space_of)
    scene = ReducedScene(
        body,
        gravity=(G * np.sin(a), 0, -G * np.cos(a)),
        obstacles=(Plane(friction=friction),),
        damping_time=2e-3,
    )
    run = simulate(scene, Timing(frames=4, fps=10, steps_per_frame=30))
    speed = mean_velocity(body, run)[1:, 0]
    if np.tan(a) < friction:
        assert np.abs(speed).max() < scene.contact().slip_velocity
    else:
        acceleration = np.polyfit(run.times[1:], speed, 1)[0]
        assert acceleration == pytest.approx(G * (np.sin(a) - friction * np.cos(a)), rel=5e-3)


@pytest.mark.parametrize("obstacle", [Plane(point=(0, 0, -0.05)), Sphere(center=(0.15, 0.1, -0.35), radius=0.3)])
def test_bounce_gains_no_energy(space_of, obstacle):
    body = slab(space_of, youngs_modulus=5e4)
    scene = ReducedScene(body, obstacles=(obstacle,))
    run = simulate(scene, Timing(frames=12, fps=48, steps_per_frame=8))
    contact, total = scene.contact(), []
    for t, y, v in zip(run.times, run.coordinates, run.velocities, strict=True):
        touch = contact.energy_and_gradient(body.space.surface_values @ y, t)[0]
        weight = (scene.external_forces(t) * (y - scene.start)).sum()
        total.append(0.5 * (v * (body.mass @ v)).sum() + touch - weight + body.energy(y))
    scale = body.total_mass * G * 0.05
    assert mean_velocity(body, run)[:, 2].min() < -0.5 and mean_velocity(body, run)[-1, 2] > -0.5  # it did hit
    assert (np.diff(total) < 3e-3 * scale).all() and total[-1] < total[0] + 2e-3 * scale


# --- against the full model


def test_dropped_soft_box_approaches_the_full_model_with_more_weights():
    """Root mean square over 12 frames, relative to the full model's deformation; falls as M grows."""
    mesh = box_mesh((0.2, 0.2, 0.2), (2, 2, 2))
    constants = {"youngs_modulus": 2e4, "poisson_ratio": 0.35}
    body = ElasticBody(mesh, **constants)
    floor = (Plane(point=(0, 0, -0.05), normal=(0.15, 0.05, 1.0)),)
    timing = Timing(frames=12, fps=48, steps_per_frame=4)
    full = simulate(Scene(body, obstacles=floor), timing).positions
    fall = np.einsum("v,tvi->ti", body.node_masses, full)[:, None] / body.total_mass
    deformation = np.sqrt(((full - fall - (full - fall)[0]) ** 2).mean())
    errors = []
    for count in (1, 6, 16):
        space = ReducedSpace(eigenmode_weights(body, count), BodySamples.of_mesh(mesh))
        reduced = simulate(ReducedScene(ReducedBody(space, **constants), obstacles=floor), timing)
        difference = reduced.positions(mesh.vertices) - full
        errors.append(np.sqrt((difference**2).mean()) / deformation)
    assert errors[0] > errors[1] > errors[2]
    assert errors[1] < 0.25 and errors[2] < 0.15, errors  # .46, .19, .12 when written


# --- errors


@pytest.mark.wrong_types
def test_bad_arguments_are_named(space_of):
    scene = ReducedScene(slab(space_of))
    for options in ({"frames": 0}, {"friction_passes": 0}, {"integrator": "euler"}):
        with pytest.raises(InputError, match=next(iter(options))):
            simulate(scene, Timing(**options))
    with pytest.raises(InputError, match="loads"):
        ReducedScene(slab(space_of), loads=Loads(np.zeros((3, 3)), np.zeros((2, 3))))
    with pytest.raises(InputError, match="damping_time"):
        ReducedScene(slab(space_of), damping_time=-1.0)


def test_a_step_that_cannot_converge_is_an_error(space_of):
    body = slab(space_of, law="neo_hookean_log")
    turned_inside_out = body.space.affine(-np.eye(3), np.zeros(3))
    with pytest.raises(ConvergenceError, match="no finite energy"):
        simulate(ReducedScene(body, initial_coordinates=turned_inside_out), Timing(frames=2))


def test_a_neural_field_works_without_a_mesh():
    import torch

    rng = np.random.default_rng(0)
    points = rng.uniform(size=(200, 3)) * SIZE
    field = CallableWeights(lambda x: torch.tanh(8 * x[:, :2] - 1), 2)
    body = ReducedBody(ReducedSpace(field, BodySamples.of_points(points, 0.006)), youngs_modulus=1e4)
    run = simulate(ReducedScene(body, initial_velocity=(0, 0, 1.0)), Timing(frames=3, steps_per_frame=4))
    assert body.total_mass == pytest.approx(6.0)
    np.testing.assert_allclose(mean_velocity(body, run)[-1, 2], 1 - G / 12, rtol=1e-6)


def test_friction_is_taken_anew_until_velocities_settle_and_then_meets_coulomb(space_of):
    """The full model's rule: passes end below `slip_velocity`, after twelve at the latest; a sliding impact keeps μ."""
    body = ReducedBody(space_of(), youngs_modulus=1e5, poisson_ratio=0.3)
    floor = Plane(point=(0, 0, -0.01), friction=0.5)
    scene = ReducedScene(body, obstacles=(floor,), initial_velocity=(2.0, 0, -1.0), gravity=(0, 0, 0))
    slip, counts = scene.contact().slip_velocity, []

    def watch(equations, record):
        counts.append(len(record.passes))
        changes = [
            np.abs(equations.surface @ (b.x - a.x)).max() / record.step
            for a, b in zip(record.passes, record.passes[1:], strict=False)
        ]
        assert all(change > slip for change in changes[:-1])
        assert len(counts) == 0 or counts[-1] in (1, 12) or changes[-1] <= slip

    run = simulate(scene, Timing(frames=3, fps=16, steps_per_frame=40), observer=watch)
    assert max(counts) > 2 and counts[0] == 1  # in flight nothing is repeated
    start, end = (body.first_moments @ run.velocities[k] for k in (0, -1))
    assert end[2] > 0  # it has left the floor
    assert (start[0] - end[0]) / (end[2] - start[2]) == pytest.approx(0.5, rel=0.03)


def stiff_plate(**changes) -> ReducedScene:
    """A thin plate that falls on a floor; its rebound takes a tenth of a step of 1/192 s."""
    mesh = box_mesh((0.3, 0.24, 0.018), (4, 3, 1), order=2)
    space = ReducedSpace(eigenmode_weights(ElasticBody(mesh), 4), BodySamples.of_mesh(mesh))
    body = ReducedBody(space, youngs_modulus=4e6, poisson_ratio=0.14, density=2000.0)
    floor = Plane(point=(0, 0, -0.05), normal=(0.1, 0.02, 1.0))
    scene = ReducedScene(body, obstacles=(floor,), initial_angular_velocity=(2.0, -1.0, 0.5))
    return dataclasses.replace(scene, **changes)


def energies(scene: ReducedScene, run: ReducedTrajectory) -> np.ndarray:
    """At the frames, over the scene's scale."""
    equations = ReducedEquations(scene)
    states = map(State, run.times, run.coordinates, run.velocities)
    return np.array([equations.energy(state) for state in states]) / scene.energy_scale


def test_an_impact_shorter_than_a_step_gains_no_energy_where_steps_are_cut():
    scene, options = stiff_plate(), Timing(frames=40, steps_per_frame=8)
    free, kept = simulate(scene, options), simulate(scene, replace(options, energy_tolerance=1e-3))
    gains = [np.max(e - np.minimum.accumulate(e)) for e in (energies(scene, free), energies(scene, kept))]
    assert gains[0] > 3e-3 > 1e-3 >= gains[1]
    assert free.statistics.halved_steps == 0 < kept.statistics.halved_steps < 20


@pytest.mark.parametrize(
    "changes",
    [
        {"obstacles": (Plane(point=(0, 0, -0.05), velocity=(0, 0, 0.5)),)},
        {"push": lambda time: (0.0, 0.0, 40.0 * time)},
    ],
)
def test_where_work_is_done_from_outside_energy_may_rise(changes):
    scene = stiff_plate(**changes)
    assert not scene.autonomous and stiff_plate().autonomous
    options = Timing(frames=12, steps_per_frame=8)
    free, asked = simulate(scene, options), simulate(scene, replace(options, energy_tolerance=1e-3))
    np.testing.assert_array_equal(free.coordinates, asked.coordinates)


def test_the_tolerance_of_the_energy_is_a_positive_share():
    with pytest.raises(InputError, match=r"energy_tolerance: got -1\.0"):
        simulate(stiff_plate(), Timing(frames=2, energy_tolerance=-1.0))


def test_a_body_that_its_weight_crushes_is_followed_though_extrapolation_turns_it_inside_out():
    """E is a tenth of ρ g L; the law's energy is infinite where a point of the first guess is turned inside out."""
    mesh = box_mesh((10.0, 10.0, 10.0), (2, 2, 2), order=2)
    space = ReducedSpace(eigenmode_weights(ElasticBody(mesh), 4), BodySamples.of_mesh(mesh))
    body = ReducedBody(space, law="neo_hookean_log", youngs_modulus=1.5e4, poisson_ratio=0.1, density=1500.0)
    scene = ReducedScene(body, obstacles=(Plane(point=(0.0, 0.0, -1.0)),), initial_velocity=(0.0, 0.0, -4.0))
    run = simulate(scene, Timing(frames=32, steps_per_frame=8))
    assert np.isfinite(run.coordinates).all()
    assert np.ptp(run.positions(mesh.vertices)[..., 2], axis=1).min() < 8.5  # of 10 m
