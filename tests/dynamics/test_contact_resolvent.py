"""Contact of a point that gives way: the law of `Contact` where the point is left, and the derivative of the force."""

import numpy as np
import pytest

from physconvex.dynamics import Contact, Plane, resolve

PLANE = Plane(friction=0.6, velocity=(0.3, 0.0, 0.0))
STEP = 1e-3
COUNT = 400


@pytest.fixture(scope="module")
def law() -> Contact:
    return Contact((PLANE,), areas=np.linspace(1e-4, 4e-3, COUNT), stiffness=1e7, smoothing=5e-4, slip_velocity=6e-3)


@pytest.fixture(scope="module")
def pushed() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places in and over the floor, velocities that stick and slip, stiffnesses of what holds the points."""
    rng = np.random.default_rng(3)
    places = rng.normal(size=(COUNT, 3)) * 2e-3
    velocities = rng.normal(size=(COUNT, 3)) * 10 ** rng.uniform(-4, 0.5, size=(COUNT, 1)) + (0.3, 0, 0)
    return places, velocities, 10 ** rng.uniform(3, 6, COUNT)


def forces(law: Contact, places: np.ndarray, velocities: np.ndarray, stiffness: np.ndarray):
    slip = (velocities - PLANE.velocity_at(0.0)) * (1, 1, 0)
    normals = np.tile([0.0, 0.0, 1.0], (COUNT, 1))
    return resolve(
        law, 0.6, areas=law.areas, normals=normals, depth=-places[:, 2], slip=slip, stiffness=stiffness, step=STEP
    )


def test_the_force_is_the_law_at_the_place_it_leaves(law, pushed):
    places, velocities, stiffness = pushed
    found = forces(law, places, velocities, stiffness).force
    give = found / stiffness[:, None]
    at, speed = places - give, velocities - give / STEP
    push = law.energy_and_gradient(at, 0.0)[1]
    hold = law.friction_energy_and_gradient(law.freeze_friction(at, speed, 0.0), speed)[1]
    relative = np.linalg.norm((speed - PLANE.velocity_at(0.0))[:, :2], axis=1)[at[:, 2] < 0]
    assert (relative < 6e-3).sum() > 20 and (relative > 6e-3).sum() > 20  # some stick, some slip
    np.testing.assert_allclose(found, push + hold, rtol=1e-9, atol=1e-9 * np.abs(found).max())


def test_the_slope_is_the_derivative(law, pushed):
    places, velocities, stiffness = pushed
    rng = np.random.default_rng(5)
    way, small = rng.normal(size=(COUNT, 3)), 1e-9
    ahead, behind = (
        forces(law, places + side * way, velocities + side * way / STEP, stiffness).force for side in (small, -small)
    )
    predicted = np.einsum("cij,cj->ci", forces(law, places, velocities, stiffness).slope, way)
    error = np.abs((ahead - behind) / (2 * small) - predicted).max(axis=1)
    assert np.quantile(error / np.abs(predicted).max(axis=1).clip(1e-9), 0.97) < 1e-3  # but for kinks between


def test_points_in_the_air_feel_nothing(law, pushed):
    places, velocities, stiffness = pushed
    found = forces(law, np.abs(places), velocities, stiffness)
    assert not found.force.any() and not found.slope.any()
