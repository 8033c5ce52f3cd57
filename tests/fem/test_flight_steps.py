"""Fewer steps while a body flies: the same motion, and the usual steps from where an obstacle is near."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex.dynamics import Loads, Plane, PreparedRollOut, Sphere, State, Stepper, Timing, bdf2, simulate
from physconvex.fem import ElasticBody, NodePins, Scene
from physconvex.fem.simulation import Flight
from physconvex.mesh import box_mesh

G = 9.81


def falling(height: float = 0.6, **fields) -> Scene:
    mesh = box_mesh((0.2, 0.2, 0.1), (2, 2, 1))
    body = ElasticBody(mesh, youngs_modulus=1e6, poisson_ratio=0.3)
    floor = Plane(point=(0, 0, -height), friction=0.5)
    fields = {"initial_angular_velocity": (1.0, -2.0, 0.5), "damping_time": 1e-3} | fields
    return Scene(body, obstacles=(floor,), **fields)


def test_a_fall_with_long_steps_is_the_same_fall():
    """Mean height: z0 − g t²/2 − 3/4 g h², the last from the first step by implicit Euler, with the short step's h."""
    scene = falling(5.0)
    options = Timing(frames=10, fps=24, steps_per_frame=24, tolerance=1e-9)
    usual, long = (simulate(scene, replace(options, flight_steps_per_frame=n)) for n in (None, 6))
    assert long.statistics.steps == 24 + 8 * 6 and usual.statistics.steps == 9 * 24
    mean = scene.body.node_masses / scene.body.total_mass
    t, step = long.times[1:], 1 / (24 * 24)
    exact = 0.05 - 0.5 * G * t**2 - 0.75 * G * step**2
    np.testing.assert_allclose(np.einsum("v,tv->t", mean, long.positions[1:, :, 2]), exact, atol=1e-8)
    # turning by up to 2.3 rad/s for 0.4 s at 144 steps a second: (ω h)² / 3 of 0.2 m
    assert np.abs(long.positions - usual.positions).max() < 2e-5


def test_steps_are_short_again_before_it_lands_and_ever_after():
    options = Timing(frames=16, fps=24, steps_per_frame=12)
    scene = falling()
    usual, long = (
        simulate(scene, replace(options, flight_steps_per_frame=n, contact_solver="condensed")) for n in (None, 4)
    )
    flight = Flight(scene, Timing(steps_per_frame=12, flight_steps_per_frame=4))
    states = map(State, long.times[:-1], long.positions, long.velocities)
    steps = [flight.steps(state) for state in states]
    # sqrt(2 · 0.6 / 9.81) s = 8.4 frames: the first frame has short steps, and those from the seventh or eighth on
    assert long.statistics.steps == sum(steps) and steps[:7] == [12, *6 * [4]] and steps[8:] == 7 * [12]
    fallen = usual.positions[0] - usual.positions
    assert np.abs(long.positions - usual.positions).max() < 1e-3 * np.abs(fallen).max()


@pytest.mark.parametrize(
    ("fields", "frame", "steps"),
    [
        ({}, 1, 4),
        ({}, 0, 12),  # starts the integrator
        ({"initial_velocity": (0, 0, -20.0)}, 1, 12),
        ({"obstacles": (Sphere(center=(0.1, 0.1, 2.0), radius=0.2, velocity=(0, 0, -30.0)),)}, 1, 12),
        ({"node_pins": NodePins(np.array([0]))}, 1, 12),
        ({"loads": Loads(np.zeros((75, 3)), np.ones((75, 3)))}, 1, 12),
    ],
)
def test_when_a_frame_is_flight(fields, frame, steps):
    obstacles = fields.get("obstacles", ())
    scene = falling(**{key: value for key, value in fields.items() if key != "obstacles"})
    scene = Scene(
        scene.body,
        obstacles=scene.obstacles + obstacles,
        node_pins=scene.node_pins,
        loads=scene.loads,
        initial_velocity=scene.initial_velocity,
    )
    flight = Flight(scene, Timing(steps_per_frame=12, flight_steps_per_frame=4))
    assert flight.steps(State(frame / 24, scene.start, scene.start_velocities())) == steps


def test_once_it_has_been_near_it_flies_no_more():
    scene = falling()
    flight = Flight(scene, Timing(steps_per_frame=12, flight_steps_per_frame=4))
    far = State(0.1, scene.start, scene.start_velocities())
    near = State(0.2, scene.start - [0, 0, 0.59], scene.start_velocities())
    assert [flight.steps(state) for state in (far, near, far)] == [4, 12, 12]


# --- the history of a step of another length


class Quiet:
    """Equations of a body without forces, that only move on."""

    friction, viscous, factorised, factorisations = (), None, True, 0

    def first_guess(self, guess, time):
        return guess

    def set_step(self, coefficients, time, guess, last):
        self.target = coefficients.target

    def freeze_friction(self, x):
        return False

    def commit(self, x):
        pass


@pytest.mark.parametrize("observed", [False, True])
def test_history_between_states_follows_a_cubic_exactly(observed):
    def cubic(t: float) -> State:
        return State(t, np.array([[1 - 2 * t + 3 * t**2 - 4 * t**3]]), np.array([[-2 + 6 * t - 12 * t**2]]))

    prepared = PreparedRollOut(Quiet(), cubic(0.0), tolerance=1e-9, stale_rate=0.25, steps_per_frame=1)
    stepper = Stepper(prepared, Timing(), observer=(lambda *_: None) if observed else None)
    stepper.recent.extend([cubic(0.0), cubic(0.5)])
    found = stepper._history(cubic(1.0), 0.2)
    equal = stepper._history(cubic(1.0), 0.5)
    assert equal.time == 0.5 and stepper._history(cubic(1.0), 2.0) is None
    if observed:  # an observer follows whole steps
        assert found is None and stepper._history(cubic(1.0), 1.0) is None
        return
    np.testing.assert_allclose(found.positions, cubic(0.8).positions, rtol=1e-12)
    np.testing.assert_allclose(found.velocities, cubic(0.8).velocities, rtol=1e-12)
    assert np.isfinite(bdf2(cubic(1.0), found, 0.2).target).all()
