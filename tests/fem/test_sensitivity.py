"""Derivatives of a full-order roll-out against central differences of whole roll-outs."""

from dataclasses import replace

import numpy as np
import pytest

from physconvex import InputError
from physconvex.dynamics import Plane, Timing, simulate, simulate_with_sensitivities
from physconvex.fem import ElasticBody, NodePins, Scene, SceneFamily
from physconvex.mesh import box_mesh

TIMING = Timing(frames=4, fps=48.0, steps_per_frame=4, tolerance=1e-11)
VALUES = np.array([4.3, 0.3, 1e-3, -0.6])
STEPS = np.array([2e-5, 1e-5, 2e-7, 1e-5])


def thrown(values):
    """A box that hits a tilted, smooth floor."""
    mesh = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=2)
    body = ElasticBody(mesh, youngs_modulus=10 ** values[0], poisson_ratio=values[1], density=1000.0)
    floor = Plane((0.0, 0.0, -0.005), (0.1, 0.05, 1.0))
    return Scene(body, obstacles=(floor,), damping_time=values[2], initial_velocity=(0.1, 0.0, values[3]))


def rough(values):
    """The same box on a rough floor, in part sticking."""
    scene = thrown(values)
    return replace(scene, obstacles=tuple(replace(plane, friction=0.8) for plane in scene.obstacles))


def damped(values):
    """A box on a smooth floor whose contact has a dashpot."""
    return replace(thrown(values), contact_damping=2e-3)


def held(values):
    """A bar that is led sideways at one end, as far as the fourth value says."""
    mesh = box_mesh((0.3, 0.1, 0.1), (3, 1, 1), order=2)
    nodes = np.flatnonzero(mesh.vertices[:, 0] < 1e-9)
    body = ElasticBody(mesh, youngs_modulus=10 ** values[0], poisson_ratio=values[1], density=1000.0)
    pins = NodePins(nodes, lambda t: mesh.vertices[nodes] + [0.0, values[3] * t, 0.0])
    return Scene(body, node_pins=pins, damping_time=values[2])


@pytest.mark.parametrize("scene_of", [thrown, held])
def test_against_central_differences_of_whole_roll_outs(scene_of):
    found = simulate_with_sensitivities(SceneFamily(scene_of=scene_of, values=VALUES, steps=STEPS), TIMING)
    np.testing.assert_array_equal(found.trajectory.positions, simulate(scene_of(VALUES), TIMING).positions)
    for k, width in enumerate(1e2 * STEPS):
        moved = [simulate(scene_of(VALUES + s * width * np.eye(4)[k]), TIMING).positions for s in (1, -1)]
        slope = (moved[0] - moved[1]) / (2 * width)
        assert np.linalg.norm(found.coordinate_tangents[:, k] - slope) < 2e-3 * np.linalg.norm(slope)


@pytest.mark.parametrize(
    ("scene_of", "passes"), [(rough, 1), (rough, 3), pytest.param(rough, 12, marks=pytest.mark.slow), (damped, 3)]
)
def test_friction_and_dashpots_are_differentiated_pass_by_pass(scene_of, passes):
    timing = replace(TIMING, frames=6, friction_passes=passes)
    found = simulate_with_sensitivities(SceneFamily(scene_of=scene_of, values=VALUES, steps=STEPS), timing)
    for k, width in enumerate(3 * STEPS):
        moved = [simulate(scene_of(VALUES + s * width * np.eye(4)[k]), timing).positions for s in (1, -1)]
        slope = (moved[0] - moved[1]) / (2 * width)
        assert np.linalg.norm(found.coordinate_tangents[:, k] - slope) < 1e-3 * np.linalg.norm(slope)


def test_at_a_bound_the_difference_is_taken_on_one_side():
    values = np.array([4.3, 0.3, 0.0, -0.6])  # no damping: a negative one is refused
    found = simulate_with_sensitivities(
        SceneFamily(scene_of=thrown, values=values, steps=STEPS, lower=[3.0, 0.0, 0.0, -9.0]), TIMING
    )
    ahead = simulate(thrown(values + np.array([0, 0, 2e-6, 0])), TIMING).positions
    slope = (ahead - found.trajectory.positions) / 2e-6
    assert np.linalg.norm(found.coordinate_tangents[:, 2] - slope) < 1e-2 * np.linalg.norm(slope)


def test_a_width_that_is_not_positive_is_named():
    with pytest.raises(InputError, match="expected one positive width"):
        simulate_with_sensitivities(SceneFamily(scene_of=thrown, values=VALUES, steps=[1e-5, 1e-5, 0.0, 1e-5]))


@pytest.mark.parametrize("option", [{"contact_solver": "condensed"}, {"flight_steps_per_frame": 2}])
def test_what_derivatives_do_not_follow_is_refused(option):
    with pytest.raises(InputError, match="contact by passes and steps of one length"):
        simulate_with_sensitivities(SceneFamily(scene_of=thrown, values=VALUES, steps=STEPS), replace(TIMING, **option))
