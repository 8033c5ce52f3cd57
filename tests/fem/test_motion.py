"""Motion without contact: free fall, spin, momentum, energy, viscosity, air drag, prescribed nodes."""

import numpy as np
import pytest

from physconvex.dynamics import Loads, Timing, simulate
from physconvex.fem import ElasticBody, NodePins, Scene, Trajectory, solve_static
from physconvex.mesh import box_mesh

G = np.array([0.0, 0.0, -9.81])


def block(order: int = 2, **constants) -> ElasticBody:
    return ElasticBody(box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=order), **({"youngs_modulus": 1e5} | constants))


def momentum(body: ElasticBody, run: Trajectory) -> np.ndarray:
    return np.einsum("ij,tjk->tk", np.asarray(body.mass.todense()), run.velocities)


def angular_momentum(body: ElasticBody, run: Trajectory) -> np.ndarray:
    return np.array([np.cross(x, body.mass @ v).sum(0) for x, v in zip(run.positions, run.velocities, strict=True)])


def energies(scene: Scene, run: Trajectory) -> np.ndarray:
    """Elastic + kinetic + gravitational energy [J] at each frame."""
    body = scene.body
    kinetic = [0.5 * (v * (body.mass @ v)).sum() for v in run.velocities]
    potential = [-(scene.external_forces(0.0) * (x - scene.start)).sum() for x in run.positions]
    elastic = [body.energy(x) for x in run.positions]
    return np.array(kinetic) + potential + elastic


def test_rest_without_forces_is_rest():
    run = simulate(Scene(block(), gravity=(0, 0, 0)), Timing(frames=5))
    np.testing.assert_allclose(run.positions, np.broadcast_to(run.positions[0], run.positions.shape), atol=1e-13)


# --- free fall: the discrete schemes have closed forms


def fall_by_hand(v0: np.ndarray, h: float, steps: int, two_step: bool) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and velocity of a point mass after the stated scheme, with an implicit Euler first step."""
    x, v = [np.zeros(3)], [v0]
    for n in range(steps):
        if two_step and n > 0:
            v.append((4 * v[-1] - v[-2] + 2 * h * G) / 3)
            x.append((4 * x[-1] - x[-2] + 2 * h * v[-1]) / 3)
        else:
            v.append(v[-1] + h * G)
            x.append(x[-1] + h * v[-1])
    return x[-1], v[-1]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("integrator", ["bdf2", "implicit_euler"])
def test_free_fall_is_the_discrete_parabola(integrator, order):
    v0 = np.array([0.5, -0.3, 1.0])
    run = simulate(
        Scene(block(order), initial_velocity=v0), Timing(frames=4, fps=10, steps_per_frame=3, integrator=integrator)
    )
    for frame in (1, 2, 3):
        fallen, speed = fall_by_hand(v0, 1 / 30, 3 * frame, integrator == "bdf2")
        np.testing.assert_allclose(run.positions[frame] - run.positions[0], fallen + 0 * run.positions[0], atol=1e-9)
        np.testing.assert_allclose(run.velocities[frame], speed + 0 * run.positions[0], atol=1e-7)


def test_bdf2_parabola_is_off_by_its_first_step_alone():
    # BDF2 is exact for polynomials of degree two; the first, implicit Euler step is off by g h²/2 in position and
    # exact in velocity, and the two-step recursion carries 3/2 of that initial offset along
    h, steps = 1 / 240, 24
    run = simulate(Scene(block()), Timing(frames=2, fps=1 / (h * steps), steps_per_frame=steps))
    t = h * steps
    offset = run.positions[1] - run.positions[0] - 0.5 * G * t**2
    np.testing.assert_allclose(offset, 1.5 * 0.5 * G * h**2 + 0 * offset, atol=1e-9)
    np.testing.assert_allclose(run.velocities[1], G * t + 0 * offset, atol=1e-8)


@pytest.mark.parametrize(("integrator", "order"), [("implicit_euler", 1), ("bdf2", 2)])
def test_free_fall_error_falls_with_the_order(integrator, order):
    errors = []
    for steps in (8, 16, 32):
        run = simulate(Scene(block(1)), Timing(frames=2, fps=4, steps_per_frame=steps, integrator=integrator))
        errors.append(np.abs(run.positions[1] - run.positions[0] - 0.5 * G * 0.25**2).max())
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), order, atol=1e-2)


# --- spin


def spinning(omega, **constants) -> Scene:
    return Scene(block(**constants), gravity=(0, 0, 0), initial_angular_velocity=omega)


def test_start_of_a_spin_is_a_rigid_motion():
    scene = Scene(block(density=700.0), initial_velocity=(1.0, 0, 0), initial_angular_velocity=(0, 0, 3.0))
    v, x = scene.start_velocities(), scene.start
    center = np.array([0.15, 0.1, 0.05])
    np.testing.assert_allclose(v, np.array([1.0, 0, 0]) + np.cross([0, 0, 3.0], x - center), atol=1e-13)
    # moment of inertia of the box about z
    inertia = scene.body.total_mass * (0.3**2 + 0.2**2) / 12
    assert 0.5 * (v * (scene.body.mass @ v)).sum() == pytest.approx(
        0.5 * scene.body.total_mass + 0.5 * inertia * 9, rel=1e-12
    )


def test_stiff_spinning_body_turns_by_the_angle_it_should():
    """Centrifugal strain is ρ ω² L²/E ~ 2e-5 here: a rigid body, of which BDF2 falls behind at second order.

    An error d of each solve would add up to d (t/h)² in the end, hence the tolerance; at that tolerance the elastic
    energy is lost in its rounding errors.
    """
    omega, t, errors = 5.0, 0.5, []
    for steps in (50, 100, 200):
        scene = spinning((0, 0, omega), youngs_modulus=1e8)
        run = simulate(scene, Timing(frames=2, fps=1 / t, steps_per_frame=steps, tolerance=1e-11))
        assert run.statistics.halved_steps == 0
        start, end = (x - (0.15, 0.1, 0.05) for x in run.positions)
        angle = np.arctan2((start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]).sum(), (start * end)[:, :2].sum())
        errors.append(abs(angle - omega * t))
        np.testing.assert_allclose(np.linalg.norm(end, axis=1), np.linalg.norm(start, axis=1), atol=1e-6)
    assert errors[-1] < 1e-3
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 2.0, atol=0.15)


@pytest.mark.parametrize("law", ["neo_hookean", "stvk"])
def test_spin_keeps_momentum_and_energy_to_second_order(law):
    drifts = []
    for steps in (20, 40, 80):
        scene = spinning((0.5, -1.0, 4.0), law=law, youngs_modulus=1e6)
        run = simulate(scene, Timing(frames=2, fps=5, steps_per_frame=steps, tolerance=1e-12))
        spin = angular_momentum(scene.body, run)
        total = energies(scene, run)
        np.testing.assert_allclose(momentum(scene.body, run), 0.0, atol=1e-8)
        drifts.append([np.linalg.norm(spin[-1] - spin[0]) / np.linalg.norm(spin[0]), abs(total[-1] / total[0] - 1)])
        assert total[-1] < total[0]  # BDF2 only dissipates
    assert max(drifts[-1]) < 5e-4
    slopes = np.log2(np.array(drifts[0]) / drifts[-1]) / 2
    # the stretching vibration that the start excites is damped too: 0.2 off second order
    np.testing.assert_allclose(slopes, 2.0, atol=0.2)


def test_momentum_of_a_thrown_deformed_body_is_exact():
    # start stretched, so that it vibrates; linear momentum obeys the point-mass recursion, to the Newton tolerance
    body = block(youngs_modulus=2e4)
    stretched = body.mesh.vertices * (1.1, 1.0, 0.95)
    scene = Scene(body, initial_positions=stretched, initial_velocity=(1.0, 2.0, 3.0))
    run = simulate(scene, Timing(frames=6, tolerance=1e-10))
    each = Scene(body, initial_positions=stretched, initial_velocities=np.tile([1.0, 2.0, 3.0], (len(stretched), 1)))
    assert np.array_equal(simulate(each, Timing(frames=6, tolerance=1e-10)).positions, run.positions)
    expected = body.total_mass * (np.array([1.0, 2, 3]) + G * run.times[:, None])
    np.testing.assert_allclose(momentum(body, run), expected, rtol=1e-6, atol=1e-6)
    assert np.ptp([body.energy(x) for x in run.positions]) > 0.1 * body.energy(stretched)  # it does vibrate


def test_vibration_loses_energy_at_the_rate_of_the_scheme():
    body = block(youngs_modulus=2e4, poisson_ratio=0.3)
    scene = Scene(body, gravity=(0, 0, 0), initial_positions=body.mesh.vertices * (1.05, 1.0, 1.0))
    losses = []
    for steps in (200, 400):
        run = simulate(scene, Timing(frames=3, fps=10, steps_per_frame=steps, tolerance=1e-9))
        total = energies(scene, run)
        assert (np.diff(total) < 0).all()
        losses.append(1 - total[-1] / total[0])
    # the start of BDF2 costs (ωh)²/2 once, each step (ωh)⁴/2: halving h divides the loss by 4 at least, by 8 at most
    assert losses[0] < 0.04
    assert 3.5 < losses[0] / losses[1] < 9.0


# --- viscosity and air drag


def test_viscosity_takes_nothing_from_a_spin_up_to_second_order():
    losses = []
    for steps in (20, 40, 80):
        pair = []
        for damping in (0.0, 0.05):
            body = block(youngs_modulus=1e6)
            scene = Scene(body, gravity=(0, 0, 0), initial_angular_velocity=(0, 0, 4.0), damping_time=damping)
            pair.append(
                energies(scene, simulate(scene, Timing(frames=2, fps=5, steps_per_frame=steps, tolerance=1e-10)))[-1]
            )
        losses.append(abs(pair[1] / pair[0] - 1))
    assert losses[-1] < 2e-3
    assert np.log2(losses[0] / losses[-1]) / 2 > 1.7


def test_damping_ratio_of_a_mode_is_half_omega_beta():
    """A bar of ν = 0 stretched along itself: first axial mode ω = π c/L, amplitude falls as exp(−β ω² t/2)."""
    mesh = box_mesh((1.0, 0.1, 0.1), (8, 1, 1))
    body = ElasticBody(mesh, law="linear", youngs_modulus=1e4, poisson_ratio=0.0)
    omega, beta = np.pi * np.sqrt(1e4 / 1000.0), 0.01
    shape = np.zeros_like(mesh.vertices)
    shape[:, 0] = np.cos(np.pi * mesh.vertices[:, 0])
    scene = Scene(body, gravity=(0, 0, 0), initial_positions=mesh.vertices + 0.01 * shape, damping_time=beta)
    period = 2 * np.pi / (omega * np.sqrt(1 - (beta * omega / 2) ** 2))
    run = simulate(scene, Timing(frames=4, fps=1 / period, steps_per_frame=300))
    amplitude = ((run.positions - mesh.vertices) * shape).sum((1, 2)) / (shape**2).sum()
    expected = 0.01 * np.exp(-beta * omega**2 / 2 * run.times)
    # BDF2 at 300 steps per period: phase and start errors of (ωh)² = 4e-4, in units of the first amplitude
    np.testing.assert_allclose(amplitude, expected, atol=1e-3 * 0.01)


def test_air_drag_slows_down_exponentially():
    scene = Scene(block(), gravity=(0, 0, 0), air_drag=2.0, initial_velocity=(3.0, 0, 0))
    run = simulate(scene, Timing(frames=3, fps=4, steps_per_frame=50))
    expected = 3.0 * np.exp(-2.0 * run.times)
    # local error of the first step (αh)²/2 = 5e-5, of the others (αh)² αt/3
    np.testing.assert_allclose(run.velocities[:, :, 0], expected[:, None] + 0 * run.velocities[:, :, 0], rtol=2e-4)


def test_terminal_velocity():
    scene = Scene(block(), air_drag=5.0)
    run = simulate(scene, Timing(frames=2, fps=0.25, steps_per_frame=200))
    np.testing.assert_allclose(run.velocities[1], G / 5.0 + 0 * run.velocities[1], atol=1e-4)


# --- prescribed nodes and loads


def test_pins_follow_their_motion_and_drag_the_body_along():
    body = block(youngs_modulus=1e7)
    nodes = np.flatnonzero(body.mesh.vertices[:, 0] == 0)
    rest = body.mesh.vertices[nodes]

    def motion(t):
        return rest + np.array([0.2 * t**2, 0.0, 0.1 * t])

    run = simulate(
        Scene(body, gravity=(0, 0, 0), node_pins=NodePins(nodes, motion)), Timing(frames=5, fps=8, steps_per_frame=40)
    )
    for x, t in zip(run.positions, run.times, strict=True):
        np.testing.assert_allclose(x[nodes], motion(t) if t else rest, atol=1e-12)
    # stiff: the whole body moves with the pins; sag from acceleration ~ρ a L²/E and the jerky start stay below 2 mm
    shift = run.positions[-1] - run.positions[0]
    np.testing.assert_allclose(shift, (0.2 * 0.25, 0, 0.05) + 0 * shift, atol=2e-3)


def test_held_pins_stay_and_do_no_work():
    body = block(youngs_modulus=3e4)
    nodes = np.flatnonzero(body.mesh.vertices[:, 0] == 0)
    scene = Scene(body, node_pins=NodePins(nodes))
    run = simulate(scene, Timing(frames=6, steps_per_frame=40))
    assert (run.positions[:, nodes] == body.mesh.vertices[nodes]).all()
    total = energies(scene, run)  # zero at the start
    released = 0.5 * body.total_mass * 9.81 * np.ptp(run.positions[:, :, 2], axis=0).max()
    assert (total <= 1e-9).all() and total[-1] > -0.02 * released


def test_a_damped_swing_comes_to_rest_in_the_static_solution():
    body = block(youngs_modulus=3e4)
    nodes = np.flatnonzero(body.mesh.vertices[:, 0] == 0)
    scene = Scene(body, node_pins=NodePins(nodes), damping_time=0.05)
    last = simulate(scene, Timing(frames=2, fps=0.05, steps_per_frame=400, tolerance=1e-10)).positions[-1]
    np.testing.assert_allclose(last, solve_static(scene), atol=1e-5)


def test_loads_may_change_with_time():
    body = block(density=500.0, youngs_modulus=1e6)
    share = body.node_masses[:, None] / body.total_mass * np.array([1.0, 0, 0])
    scene = Scene(body, gravity=(0, 0, 0), loads=Loads(body.mesh.vertices, lambda t: 6.0 * t * share))
    run = simulate(scene, Timing(frames=2, fps=2, steps_per_frame=100))
    # m v = 3 t²; BDF2 of a quadratic velocity: (h/t)² = 1e-4, the first step adds as much
    np.testing.assert_allclose(momentum(body, run)[1], [3 * 0.25, 0, 0], rtol=5e-4, atol=1e-9)
