"""Bodies that rest, slide, bounce and are carried: contact and friction against closed forms."""

import numpy as np
import pytest

from physconvex.dynamics import Plane, Sphere, Timing, simulate
from physconvex.fem import ElasticBody, Scene, Trajectory
from physconvex.mesh import box_mesh, refine_uniformly

G = 9.81
SLAB = (0.2, 0.2, 0.05)


def slab(cells=(2, 2, 1), order: int = 2, **constants) -> ElasticBody:
    return ElasticBody(
        box_mesh(SLAB, cells, order=order), **({"youngs_modulus": 2e5, "poisson_ratio": 0.3} | constants)
    )


def mean_velocity(body: ElasticBody, run: Trajectory) -> np.ndarray:
    return np.einsum("v,tvi->ti", body.node_masses, run.velocities) / body.total_mass


def settle(scene: Scene) -> np.ndarray:
    """Where a body comes to rest: implicit Euler with large steps, which damps everything."""
    run = simulate(scene, Timing(frames=2, fps=0.1, steps_per_frame=100, integrator="implicit_euler", tolerance=1e-10))
    assert np.abs(run.velocities[-1]).max() < 1e-6
    return run.positions[-1]


# --- rest


def hinge_depth(pressure: float, stiffness: float, smoothing: float) -> float:
    """Depth at which the hinge gives that pressure."""
    soft = np.sqrt(2 * smoothing * pressure / stiffness)
    return soft if soft < smoothing else pressure / stiffness + smoothing / 2


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("normal", [(0, 0, 1.0), (0.6, 0.0, 0.8)])
def test_resting_body_sinks_in_by_its_weight(order, normal):
    """Σ areas × pressure(depth) = weight; gravity is turned with the plane so that nothing slides."""
    n = np.array(normal)
    frame = np.array([[n[2], 0, n[0]], [0, 1, 0], [-n[0], 0, n[2]]])  # turns z into n
    body = slab(order=order, youngs_modulus=1e7)
    scene = Scene(
        body,
        gravity=-G * n,
        obstacles=(Plane(normal=normal),),
        contact_stiffness=1e7,
        contact_smoothing=1e-5,
        initial_positions=body.mesh.vertices @ frame.T,
    )
    depth = -(settle(scene) @ n)
    bottom = body.mesh.vertices[:, 2] == 0
    area = body.mesh.node_areas[bottom].sum()
    expected = hinge_depth(body.total_mass * G / area, 1e7, 1e-5)
    # the slab bends under the uneven nodal areas by about ρ g L⁴/(E h²) ~ 1e-6 m of a depth of 3e-5 m
    assert np.average(depth[bottom], weights=body.mesh.node_areas[bottom]) == pytest.approx(expected, rel=0.01)
    assert (depth[~bottom] < 0).all()


@pytest.mark.slow
def test_penetration_does_not_depend_on_the_mesh():
    depths, excess = [], []
    for mesh in (
        coarse := box_mesh(SLAB, (2, 2, 1), order=1),
        refine_uniformly(coarse),
        refine_uniformly(refine_uniformly(coarse)),
    ):
        body = ElasticBody(mesh, youngs_modulus=1e7, poisson_ratio=0.3)
        scene = Scene(body, obstacles=(Plane(),), contact_stiffness=1e6, contact_smoothing=1e-6)
        bottom = mesh.vertices[:, 2] == 0
        weights = mesh.node_areas[bottom]
        depths.append(-np.average(settle(scene)[bottom, 2], weights=weights))
        excess.append(weights.sum() / 0.04 - 1)
    exact = 1000.0 * 0.05 * G / 1e6
    # the nodes on the rim also carry area of the sides, a share that halves with the mesh size: so does the error
    errors = 1 - np.array(depths) / exact
    np.testing.assert_allclose(errors, [e / (1 + e) for e in excess], atol=0.01)
    assert excess[2] == pytest.approx(0.8 * 0.0125 / 2 / 0.04)  # rim × half an edge of 12.5 mm over the area
    assert errors[0] / errors[2] > 3


# --- friction on a slope


def on_a_slope(angle: float, friction: float, **fields) -> Scene:
    """A slab on the plane z = 0 with gravity tilted by that many degrees."""
    a = np.radians(angle)
    gravity = (G * np.sin(a), 0, -G * np.cos(a))
    return Scene(slab(), gravity=gravity, obstacles=(Plane(friction=friction),), damping_time=2e-3, **fields)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [10, 20, 25])
def test_sticks_below_the_friction_angle(angle):
    # "sticking" creeps at the velocity where the smoothed law 2y − y² balances tan(angle)/μ
    friction = 0.5  # 26.6°
    scene = on_a_slope(angle, friction)
    run = simulate(scene, Timing(frames=3, fps=5, steps_per_frame=40))
    creep = (1 - np.sqrt(1 - np.tan(np.radians(angle)) / friction)) * scene.contact().slip_velocity
    assert mean_velocity(scene.body, run)[-1, 0] == pytest.approx(creep, rel=1e-3)
    assert creep < 3e-3  # m/s


@pytest.mark.parametrize("angle", [30, 45])
def test_slides_above_the_friction_angle(angle):
    scene = on_a_slope(angle, 0.5)
    run = simulate(scene, Timing(frames=4, fps=10, steps_per_frame=40))
    a = np.radians(angle)
    speed = mean_velocity(scene.body, run)
    # from t = 0.1 s on, when the slab has settled in the hinge
    acceleration = np.polyfit(run.times[1:], speed[1:, 0], 1)[0]
    assert acceleration == pytest.approx(G * (np.sin(a) - 0.5 * np.cos(a)), rel=2e-3)
    np.testing.assert_allclose(speed[1:, 1], 0.0, atol=2e-3)


def test_slides_freely_without_friction():
    scene = on_a_slope(20, 0.0)
    run = simulate(scene, Timing(frames=3, fps=10, steps_per_frame=20))
    expected = G * np.sin(np.radians(20)) * run.times
    # momentum along the plane is conserved: only BDF2's exactness for a uniform acceleration counts
    np.testing.assert_allclose(mean_velocity(scene.body, run)[:, 0], expected, rtol=1e-6)


# --- moving obstacles


def test_conveyor_drags_a_slab_up_to_its_own_speed():
    friction, belt = 0.4, 0.6
    body = slab()
    scene = Scene(body, obstacles=(Plane(friction=friction, velocity=(belt, 0, 0)),), damping_time=2e-3)
    run = simulate(scene, Timing(frames=7, fps=20, steps_per_frame=20))
    speed = mean_velocity(body, run)[:, 0]
    # weight sets in with the hinge's first bounces: impulse μ g t up to 2 % of the belt's speed
    np.testing.assert_allclose(speed, np.minimum(friction * G * run.times, belt), atol=0.02 * belt)
    assert speed[-1] == pytest.approx(belt, rel=1e-4)


def test_rising_plane_lifts_a_body():
    body = slab()
    scene = Scene(body, obstacles=(Plane(velocity=(0, 0, 0.3)),), damping_time=5e-3)
    run = simulate(scene, Timing(frames=3, fps=4, steps_per_frame=80))
    assert mean_velocity(body, run)[-1, 2] == pytest.approx(0.3, rel=0.02)
    bottom = body.mesh.vertices[:, 2] == 0
    np.testing.assert_allclose(run.positions[-1, bottom, 2], 0.3 * 0.5, atol=2e-3)


def test_moving_sphere_pushes_a_body_away():
    body = slab()
    ball = Sphere(center=(-0.2, 0.1, 0.025), radius=0.15, velocity=(1.0, 0, 0))
    run = simulate(Scene(body, gravity=(0, 0, 0), obstacles=(ball,)), Timing(frames=3, fps=5, steps_per_frame=60))
    speed = mean_velocity(body, run)[-1]
    # an infinitely heavy ball at speed v gives at most 2 v, and at least v (the body is then ahead of it)
    assert 1.0 < speed[0] <= 2.0
    # symmetric set-up but for the mesh's diagonals
    assert np.abs(speed[1:]).max() < 0.05
    assert ball.gap(run.positions[-1], run.times[-1]).min() > 0


# --- bounces


def energy(scene: Scene, run: Trajectory) -> np.ndarray:
    """All energy [J] but friction's, at each frame."""
    body, contact = scene.body, scene.contact()
    total = []
    for t, x, v in zip(run.times, run.positions, run.velocities, strict=True):
        kinetic = 0.5 * (v * (body.mass @ v)).sum()
        potential = -(scene.external_forces(t) * (x - scene.start)).sum() + contact.energy_and_gradient(x, t)[0]
        total.append(kinetic + potential + body.energy(x))
    return np.array(total)


@pytest.mark.slow
@pytest.mark.parametrize("obstacle", [Plane(point=(0, 0, -0.1)), Sphere(center=(0.1, 0.1, -0.4), radius=0.3)])
def test_elastic_bounce_gains_no_energy(obstacle):
    scene = Scene(slab(youngs_modulus=1e5), obstacles=(obstacle,))
    run = simulate(scene, Timing(frames=16, fps=48, steps_per_frame=16))
    height = np.einsum("v,tvi->ti", scene.body.node_masses, run.positions)[:, 2] / scene.body.total_mass
    bounced = np.argmin(height)
    assert 0 < bounced < 15  # it did hit, and came up again
    total = energy(scene, run)
    scale = scene.body.total_mass * G * (height[0] - height[bounced])
    assert (np.diff(total) < 2e-3 * scale).all()
    assert total[-1] < total[0] + 1e-3 * scale


@pytest.mark.slow
def test_bounce_conserves_energy_as_steps_shrink():
    losses = []
    for steps in (8, 16, 32):
        scene = Scene(slab(youngs_modulus=1e5), obstacles=(Plane(point=(0, 0, -0.1)),))
        run = simulate(scene, Timing(frames=2, fps=4, steps_per_frame=12 * steps))
        total = energy(scene, run)
        losses.append((total[0] - total[-1]) / (scene.body.total_mass * G * 0.1))
    assert losses[0] > losses[1] > losses[2] > 0
    assert losses[2] < 0.5 * losses[0]


def test_smooth_plane_leaves_tangential_momentum_alone():
    floor = Plane(point=(0, 0, -0.02))
    scene = Scene(slab(), gravity=(0, 0, 0), obstacles=(floor,), initial_velocity=(1.0, 0.5, -1.0))
    run = simulate(scene, Timing(frames=5, fps=24))
    speed = mean_velocity(scene.body, run)
    assert speed[-1, 2] > 0  # bounced
    np.testing.assert_allclose(speed[:, :2], np.broadcast_to([1.0, 0.5], (5, 2)), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "modulus", "passes", "tolerance"),
    [(0.2, 1e5, 12, 0.01), (0.2, 1e5, 2, 0.05), (0.2, 1e6, 12, 0.03), (0.5, 1e5, 12, 0.01), (0.5, 1e6, 12, 0.01)],
)
def test_sliding_impact_exchanges_impulses_by_coulombs_law(friction, modulus, passes, tolerance):
    """A body that slides through the whole impact loses μ times the normal impulse, whatever the force's course.

    The normal forces of the first pass come from the last state: two passes leave a few per cent; repeated until the
    velocities stand still, what is left is the step's.
    """
    body = ElasticBody(box_mesh((0.2, 0.2, 0.1), (2, 2, 1)), youngs_modulus=modulus, poisson_ratio=0.3)
    scene = Scene(
        body,
        gravity=(0, 0, 0),
        obstacles=(Plane(point=(0, 0, -0.02), friction=friction),),
        initial_velocity=(4.0, 0, -2.0),
    )
    run = simulate(scene, Timing(frames=2, fps=8, steps_per_frame=50, friction_passes=passes))
    start, end = mean_velocity(body, run)
    assert end[2] > 1.0 and end[0] > 1.0  # it bounced, and never stuck
    assert (start - end)[0] / (end - start)[2] == pytest.approx(friction, rel=tolerance)
