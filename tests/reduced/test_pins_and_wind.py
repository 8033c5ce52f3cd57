"""Pins, handles, wind, push and moving obstacles: closed forms, and derivatives of the roll-out."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex import InputError
from physconvex.dynamics import Pins, Plane, Timing, Wind, simulate, simulate_with_sensitivities
from physconvex.reduced import (
    NamedParameters,
    ReducedBody,
    ReducedScene,
    parameter_values,
    simulate_with_adjoint,
    with_parameters,
)
from tests.reduced.sliding_scene import sliding

SIZE = (0.3, 0.2, 0.1)
STILL = {"gravity": (0, 0, 0)}
NEARLY_STATIC = Timing(frames=2, fps=0.2, steps_per_frame=4, integrator="implicit_euler", tolerance=1e-10)


def end_pins(body: ReducedBody, end: float, **fields) -> Pins:
    """Pins of the samples of one end face, with their shares of its area."""
    samples = body.space.samples
    chosen = np.isclose(samples.surface_points[:, 0], end)
    return Pins(samples.surface_points[chosen], SIZE[1] * SIZE[2] / chosen.sum(), **fields)


def test_a_stretched_bar_pulls_back_with_its_stiffness(space_of):
    """Both ends held, one led outwards by a strain of 1e-3: force E A ε (ν = 0: clamping adds none)."""
    body, strain = ReducedBody(space_of(), youngs_modulus=2e5, poisson_ratio=0.0), 1e-3
    left, right = end_pins(body, 0.0), end_pins(body, SIZE[0])
    both = Pins(
        np.vstack([left.points, right.points]),
        np.concatenate([left.areas, right.areas]),
        motion=lambda t: np.vstack([left.points, right.points + np.array([strain * SIZE[0], 0, 0])]),
    )
    scene = ReducedScene(body, pins=both, **STILL)
    run = simulate(scene, NEARLY_STATIC)
    springs = scene.pin_springs()
    assert springs is not None
    force = springs.pull(run.coordinates[-1], run.times[-1])
    expected = 2e5 * 0.02 * strain
    # the springs' own compliance is 2/1000 of the bar's
    assert force[len(left.points) :, 0].sum() == pytest.approx(expected, rel=4e-3)
    np.testing.assert_allclose(force.sum(0), 0.0, atol=1e-4 * expected)


def test_a_held_body_hangs_and_a_led_one_follows(space_of):
    body = ReducedBody(space_of(), youngs_modulus=1e6)
    hanging = ReducedScene(body, pins=end_pins(body, 0.0))
    springs = hanging.pin_springs()
    assert springs is not None
    run = simulate(hanging, NEARLY_STATIC)
    weight = body.total_mass * 9.81
    pull = springs.pull(run.coordinates[-1], run.times[-1]).sum(0)
    np.testing.assert_allclose(pull, [0, 0, weight], atol=1e-3 * weight)
    face = end_pins(body, 0.0)
    led = replace(face, motion=lambda t: face.points + np.array([0.2 * t, 0, 0]))
    moved = simulate(ReducedScene(body, pins=led, **STILL), Timing(frames=3, fps=2, steps_per_frame=20))
    np.testing.assert_allclose(
        moved.positions(face.points)[-1] - face.points, [[0.2, 0, 0]] * len(face.points), atol=2e-3
    )


def test_a_falling_body_approaches_its_terminal_velocity(space_of):
    """m g = ½ ρ_air C_d (A/4) v²."""
    body = ReducedBody(space_of(), youngs_modulus=1e6, density=10.0)
    wind = Wind((1.0, 0.0, 2.0), drag_coefficient=1.1)
    area = body.space.samples.surface_areas.sum()
    run = simulate(
        ReducedScene(body, wind=wind), Timing(frames=3, fps=1, steps_per_frame=40, integrator="implicit_euler")
    )
    falling = np.sqrt(body.total_mass * 9.81 / (0.5 * 1.2 * 1.1 * area / 4))
    velocity = run.point_velocities(np.array([[0.15, 0.1, 0.05]]))[-1, 0]
    np.testing.assert_allclose(velocity, [1.0, 0.0, 2.0 - falling], atol=0.02 * falling)


def test_a_push_that_grows_with_time(space_of):
    """a = j t gives v = j t²/2 and adds to gravity."""
    body = ReducedBody(space_of(), youngs_modulus=1e6)
    scene = ReducedScene(body, push=lambda t: (-6.0 * t, 0, 9.81))
    run = simulate(scene, Timing(frames=2, fps=2, steps_per_frame=40))
    velocity = run.point_velocities(np.array([[0.15, 0.1, 0.05]]))[-1, 0]
    np.testing.assert_allclose(velocity, [-0.75, 0, 0], atol=0.03)  # implicit: one step's push too much


def test_a_floor_that_starts_to_slide_takes_the_body_along(space_of):
    body = ReducedBody(space_of(), youngs_modulus=2e5, poisson_ratio=0.3)
    floor = Plane(friction=0.8, velocity=lambda t: (-min(4.0 * t, 1.0), 0.0, 0.0))
    run = simulate(
        ReducedScene(body, obstacles=(floor,), damping_time=5e-3), Timing(frames=6, fps=10, steps_per_frame=16)
    )
    velocity = body.first_moments @ run.velocities[-1] / body.total_mass
    assert velocity[0] == pytest.approx(-1.0, abs=0.05)


def held_scene(body: ReducedBody, **fields) -> ReducedScene:
    pins = Pins(body.space.samples.surface_points[:3], 2e-3, stiffness=None)
    return sliding(body, seed=4, pins=pins, obstacles=(), **fields)


TIMING = Timing(frames=3, fps=48, steps_per_frame=3, tolerance=1e-11)


@pytest.mark.parametrize("name", ["log10_youngs_modulus", "initial_position_x", "density", "wind_y"])
def test_sensitivities_with_pins(mixed_body, name):
    scene = held_scene(mixed_body(1))
    run = simulate_with_sensitivities(NamedParameters(scene, [name]), TIMING)
    value, step = parameter_values(scene, [name]), 1e-2 if name == "density" else 1e-5
    ends = [simulate(with_parameters(scene, [name], value + s), TIMING).coordinates for s in (step, -step)]
    expected = (ends[0] - ends[1]) / (2 * step)
    assert np.linalg.norm(run.coordinate_tangents[:, 0] - expected) < 1e-4 * np.linalg.norm(expected)


def test_the_adjoint_knows_where_pins_hold_the_body(mixed_body):
    scene = held_scene(mixed_body(1))

    def loss(run):
        return float((run.coordinates**2).sum()), 2 * run.coordinates

    names = ["initial_position_z", "wind_x", "log10_youngs_modulus"]
    found = simulate_with_adjoint(scene, loss, TIMING, parameters=names)
    forward = simulate_with_sensitivities(NamedParameters(scene, names), TIMING)
    expected = np.einsum("tpri,tri->p", forward.coordinate_tangents, 2 * forward.trajectory.coordinates)
    np.testing.assert_allclose(found.named, expected, rtol=1e-7)
    shift, turned = (
        np.random.default_rng(0).normal(size=scene.start.shape),
        replace(scene, initial_orientation=(0, 0, 0)),
    )
    ends = [
        loss(simulate(replace(turned, initial_coordinates=scene.start + s * shift), TIMING))[0] for s in (1e-6, -1e-6)
    ]
    assert (found.initial_coordinates * shift).sum() == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-4)


@pytest.mark.wrong_types
def test_bad_boundaries_are_named(space_of):
    body = ReducedBody(space_of())
    with pytest.raises(InputError, match=r"pins\.points"):
        Pins(np.zeros((0, 3)), 1.0)
    with pytest.raises(InputError, match=r"pins\.areas"):
        Pins(np.zeros((2, 3)), -1.0)
    with pytest.raises(InputError, match=r"pins\.motion"):
        simulate(ReducedScene(body, pins=Pins(np.zeros((2, 3)), 1.0, motion=lambda t: np.zeros(3))), Timing(frames=2))
    with pytest.raises(InputError, match="drag_coefficient"):
        Wind(drag_coefficient=-1.0)
    with pytest.raises(InputError, match="push"):
        ReducedScene(body, push=lambda t: (1.0, 2.0))
    with pytest.raises(InputError, match="wind"):
        simulate_with_sensitivities(NamedParameters(ReducedScene(body), ["wind_x"]))
