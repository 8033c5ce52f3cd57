"""Contact law: gaps, the C² hinge, friction, and their derivatives by finite differences."""

import numpy as np
import pytest

from physconvex import InputError
from physconvex.dynamics import Contact, Plane, Sphere

STEP = 1e-6  # of lengths and velocities of size 1: central differences err by about 1e-10 relatively
SMOOTHING, SLIP_VELOCITY = 0.02, 0.1
TILTED = Plane(point=(0.1, 0.2, -0.05), normal=(1.0, 2.0, 3.0), friction=0.4, velocity=(0.3, -0.1, 0.2))
BALL = Sphere(center=(0.0, 0.0, -1.0), radius=1.1, friction=0.7, velocity=(0.0, 0.4, 0.1))


def contact_with(*obstacles, areas=None, count=20, stiffness=50.0) -> Contact:
    areas = np.linspace(0.5, 2.0, count) if areas is None else areas
    return Contact(obstacles, areas, stiffness=stiffness, smoothing=SMOOTHING, slip_velocity=SLIP_VELOCITY)


def nodes_about(obstacle, time: float, depths: np.ndarray, seed: int = 0) -> np.ndarray:
    """Random points that lie at the given depths inside the obstacle."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(len(depths), 3)) * 0.3 + (0.0, 0.0, 0.5)
    return x - (obstacle.gap(x, time) + depths)[:, None] * obstacle.normals(x, time)


def gradient_by_differences(function, x: np.ndarray) -> np.ndarray:
    gradient = np.zeros_like(x)
    for index in np.ndindex(x.shape):
        shift = np.zeros_like(x)
        shift[index] = STEP
        gradient[index] = (function(x + shift) - function(x - shift)) / (2 * STEP)
    return gradient


# depths that straddle the hinge's joint at ε and stay away from its start at 0, plus nodes outside
DEPTHS = np.concatenate([np.linspace(0.15, 3.1, 14) * SMOOTHING, -np.linspace(0.2, 1.0, 6) * SMOOTHING])


@pytest.mark.parametrize("obstacle", [TILTED, BALL])
def test_gap_and_normal(obstacle):
    time = 0.7
    x = nodes_about(obstacle, time, DEPTHS)
    np.testing.assert_allclose(obstacle.gap(x, time), -DEPTHS, atol=1e-14)
    slopes = gradient_by_differences(lambda y: obstacle.gap(y, time).sum(), x)
    np.testing.assert_allclose(obstacle.normals(x, time), slopes, atol=1e-8)


@pytest.mark.parametrize("obstacle", [TILTED, BALL])
def test_curvature_is_that_of_the_gap(obstacle):
    x = nodes_about(obstacle, 0.2, DEPTHS[:3])
    for point, curvature, normal in zip(x, obstacle.curvature(x, 0.2), obstacle.normals(x, 0.2), strict=True):
        turned = [obstacle.normals(point[None] + s * STEP * d, 0.2)[0] for d in np.eye(3) for s in (1, -1)]
        hessian = (np.array(turned[::2]) - np.array(turned[1::2])) / (2 * STEP)
        np.testing.assert_allclose(hessian, curvature * (np.eye(3) - np.outer(normal, normal)), atol=1e-8)


def test_a_moving_plane_takes_its_gap_along():
    plane = Plane(normal=(0, 0, 2.0), velocity=(5.0, 0.0, 0.5))
    np.testing.assert_allclose(plane.gap(np.array([[0.3, 0.1, 1.0]]), 1.0), 0.5)


def test_hinge_has_the_stated_values():
    kc, e = 50.0, SMOOTHING
    energy, slope, curvature = contact_with(TILTED).hinge(np.array([e / 2, e, 3 * e]))
    np.testing.assert_allclose(energy, kc * e**2 * np.array([1 / 48, 1 / 6, 9 / 2 - 3 / 2 + 1 / 6]))
    np.testing.assert_allclose(slope, kc * e * np.array([1 / 8, 1 / 2, 5 / 2]))
    np.testing.assert_allclose(curvature, kc * np.array([1 / 2, 1.0, 1.0]))


@pytest.mark.parametrize("where", [0.0, SMOOTHING])
def test_hinge_is_twice_continuous(where):
    contact, eps = contact_with(TILTED), 1e-12
    left = contact.hinge(np.array([max(where - eps, 0.0)]))
    right = contact.hinge(np.array([where + eps]))
    scale = (SMOOTHING**2, SMOOTHING, 1.0)
    for a, b, unit in zip(left, right, scale, strict=True):
        np.testing.assert_allclose(a, b, atol=50 * unit * 10 * eps / SMOOTHING)


@pytest.mark.parametrize("obstacles", [(TILTED,), (BALL,), (TILTED, BALL)])
def test_contact_force_is_the_derivative_of_the_energy(obstacles):
    contact, time = contact_with(*obstacles), 0.3
    x = nodes_about(obstacles[-1], time, DEPTHS)
    energy, gradient = contact.energy_and_gradient(x, time)
    assert energy > 0
    expected = gradient_by_differences(lambda y: contact.energy_and_gradient(y, time)[0], x)
    np.testing.assert_allclose(gradient, expected, atol=1e-7)


def test_contact_blocks_are_the_derivative_of_the_force():
    contact, time = contact_with(TILTED), 0.3
    x = nodes_about(TILTED, time, DEPTHS)
    blocks = contact.hessian_blocks(x, time)
    for axis, direction in enumerate(np.eye(3)):
        ahead = contact.energy_and_gradient(x + STEP * direction, time)[1]
        behind = contact.energy_and_gradient(x - STEP * direction, time)[1]
        np.testing.assert_allclose(blocks[:, :, axis], (ahead - behind) / (2 * STEP), atol=1e-6)


def test_sphere_blocks_leave_out_the_curvature_and_nothing_else():
    contact, time = contact_with(BALL), 0.3
    x = nodes_about(BALL, time, DEPTHS)
    _, gradient = contact.energy_and_gradient(x, time)
    normals = BALL.normals(x, time)
    push = (gradient * normals).sum(1)  # negative
    plane = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    full = contact.hessian_blocks(x, time) + (push * BALL.curvature(x, time))[:, None, None] * plane
    for axis, direction in enumerate(np.eye(3)):
        ahead = contact.energy_and_gradient(x + STEP * direction, time)[1]
        behind = contact.energy_and_gradient(x - STEP * direction, time)[1]
        np.testing.assert_allclose(full[:, :, axis], (ahead - behind) / (2 * STEP), atol=1e-6)
    assert np.linalg.eigvalsh(contact.hessian_blocks(x, time)).min() > -1e-12


def frozen_at(contact: Contact, obstacle, speed: float):
    """Positions in touch, velocities that slip at about `speed`, and the friction frozen there."""
    x = nodes_about(obstacle, 0.3, DEPTHS)
    v = np.asarray(obstacle.velocity) + speed * np.random.default_rng(1).normal(size=(20, 3))
    return x, v, contact.freeze_friction(x, v, 0.3)


@pytest.mark.parametrize("obstacle", [TILTED, BALL])
@pytest.mark.parametrize("speed", [0.01, 0.08, 2.0])  # below, near and above the slip velocity
def test_friction_derivatives(obstacle, speed):
    contact = contact_with(obstacle)
    _, _, frozen = frozen_at(contact, obstacle, speed)
    v = np.random.default_rng(2).normal(size=(20, 3))  # not where it was frozen
    _, gradient = contact.friction_energy_and_gradient(frozen, v)
    expected = gradient_by_differences(lambda u: contact.friction_energy_and_gradient(frozen, u)[0], v)
    np.testing.assert_allclose(gradient, expected, rtol=1e-7, atol=1e-7)
    blocks = contact.friction_blocks(frozen)
    for axis, direction in enumerate(np.eye(3)):
        ahead = contact.friction_energy_and_gradient(frozen, v + STEP * direction)[1]
        behind = contact.friction_energy_and_gradient(frozen, v - STEP * direction)[1]
        np.testing.assert_allclose(blocks[:, :, axis], (ahead - behind) / (2 * STEP), rtol=1e-6, atol=1e-6)
    assert np.linalg.eigvalsh(blocks).min() > -1e-9


@pytest.mark.parametrize("obstacle", [TILTED, BALL])
@pytest.mark.parametrize("speed", [0.01, 0.08, 2.0])
def test_frozen_friction_is_the_smoothed_coulomb_law_where_it_is_frozen(obstacle, speed):
    contact = contact_with(obstacle)
    x, v, frozen = frozen_at(contact, obstacle, speed)
    _, push = contact.energy_and_gradient(x, 0.3)
    _, drag = contact.friction_energy_and_gradient(frozen, v)
    normals = obstacle.normals(x, 0.3)
    slip = v - np.asarray(obstacle.velocity)
    slip = slip - (slip * normals).sum(1, keepdims=True) * normals
    size = np.linalg.norm(slip, axis=1, keepdims=True)
    y = np.minimum(size / SLIP_VELOCITY, 1.0)
    normal_force = np.linalg.norm(push, axis=1, keepdims=True)  # zero outside
    expected = obstacle.friction * normal_force * (2 * y - y**2) * slip / size  # IPC, eq. 14
    np.testing.assert_allclose(drag, expected, rtol=1e-10, atol=1e-12)


def test_frozen_dissipation_bounds_the_true_one_from_above():
    """A quadratic in |v| that touches f₀ and majorises it: this is why re-freezing converges."""
    contact = contact_with(TILTED, areas=np.array([1.0]))
    x, along = (
        nodes_about(TILTED, 0.0, np.array([0.05])),
        np.array([[2.0, -1.0, 0.0]]) / np.sqrt(5),
    )  # tangential
    still = np.asarray(TILTED.velocity)
    limit = TILTED.friction * contact.hinge(np.array([0.05]))[1][0]
    speeds = np.linspace(0.0, 0.5, 26)
    y = np.minimum(speeds / SLIP_VELOCITY, 1.0)
    true = limit * np.where(speeds < SLIP_VELOCITY, SLIP_VELOCITY * (y**2 - y**3 / 3), speeds - SLIP_VELOCITY / 3)
    for at in (0.03, 0.09, 0.25):
        frozen = contact.freeze_friction(x, still + at * along, 0.0)
        energy = np.array([contact.friction_energy_and_gradient(frozen, still + s * along)[0] for s in speeds])
        excess = energy - true
        touch = contact.friction_energy_and_gradient(frozen, still + at * along)[0] - np.interp(at, speeds, true)
        assert (excess >= touch - limit * 1e-3).all()  # 1e-3 m/s × limit: linear interpolation of `true`


def test_friction_at_rest_is_finite():
    contact = contact_with(TILTED)
    v = np.broadcast_to(np.asarray(TILTED.velocity), (20, 3)).copy()
    x = nodes_about(TILTED, 0.0, DEPTHS)
    frozen = contact.freeze_friction(x, v, 0.0)
    np.testing.assert_allclose(contact.friction_energy_and_gradient(frozen, v)[1], 0.0, atol=1e-12)
    force = np.linalg.norm(contact.energy_and_gradient(x, 0.0)[1], axis=1)[frozen[0].nodes]
    np.testing.assert_allclose(frozen[0].weights, 2 * TILTED.friction * force / SLIP_VELOCITY)  # f₁(y)/y → 2


def test_smooth_obstacle_and_inner_nodes_feel_no_friction():
    x = nodes_about(TILTED, 0.0, DEPTHS)
    assert contact_with(Plane(normal=(0, 0, 1))).freeze_friction(x, x, 0.0) == ()
    inner = contact_with(TILTED, areas=np.zeros(20))
    assert inner.freeze_friction(x, x, 0.0) == ()
    assert inner.energy_and_gradient(x, 0.0)[0] == 0.0


def test_energy_counts_area_not_points():
    x = np.array([[0.0, 0.0, -0.03]])
    floor = Plane()
    coarse = contact_with(floor, areas=np.array([1.2])).energy_and_gradient(x, 0.0)[0]
    fine = contact_with(floor, areas=np.full(6, 0.2)).energy_and_gradient(np.repeat(x, 6, axis=0), 0.0)[0]
    assert fine == pytest.approx(coarse)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Plane(normal=(0, 0, 0)), "normal: got the zero vector"),
        (lambda: Plane(point=(0, 0)), "point: got"),
        (lambda: Plane(velocity=(0, 0, np.nan)), "velocity: got"),
        (lambda: Plane(friction=-0.1), "friction: got -0.1"),
        (lambda: Sphere(center=(0, 0, 0), radius=0.0), "radius: got 0.0"),
        (lambda: Sphere(center=(0, 0, np.inf), radius=1.0), "center: got"),
        (lambda: Sphere(center=(0, 0, 0), radius=1.0, friction=np.inf), "friction: got inf"),
        (
            lambda: Contact((), np.ones(3), stiffness=0.0, smoothing=1.0, slip_velocity=1.0),
            "stiffness: got 0.0",
        ),
    ],
)
def test_bad_input_is_named(make, message):
    with pytest.raises(InputError, match=message):
        make()
