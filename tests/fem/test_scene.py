"""Roll-outs as a program: arguments, frames, halved steps, pins, errors, modes."""

import numpy as np
import pytest

from physconvex import ConvergenceError, InputError
from physconvex.dynamics import Plane, Timing, simulate, stepping as module
from physconvex.fem import ElasticBody, NodePins, Scene, skinning_eigenmodes, vibration_modes
from physconvex.materials import LAWS, with_fibres
from physconvex.mesh import box_mesh


def small_body(**constants) -> ElasticBody:
    return ElasticBody(box_mesh((0.2, 0.1, 0.1), (2, 1, 1)), **constants)


# --- frames


def test_frames_lie_at_their_times():
    run = simulate(Scene(small_body()), Timing(frames=5, fps=30, steps_per_frame=2))
    np.testing.assert_allclose(run.times, np.arange(5) / 30, rtol=1e-14)
    assert run.positions.shape == run.velocities.shape == (5, *small_body().mesh.vertices.shape)
    np.testing.assert_array_equal(run.positions[0], small_body().mesh.vertices)
    assert run.statistics.steps == 8
    assert run.statistics.newton_iterations >= 8
    assert run.statistics.halved_steps == 0


def test_one_frame_is_the_start():
    scene = Scene(small_body(), initial_velocity=(1.0, 0, 0))
    run = simulate(scene, Timing(frames=1))
    np.testing.assert_array_equal(run.velocities[0], scene.start_velocities())
    assert run.statistics.steps == 0


def test_same_scene_same_bits():
    scene = Scene(small_body(), obstacles=(Plane(point=(0, 0, -0.01), friction=0.3),), damping_time=1e-3)
    runs = [simulate(scene, Timing(frames=6)) for _ in range(2)]
    np.testing.assert_array_equal(runs[0].positions, runs[1].positions)


# --- failure of a step


def test_step_that_fails_is_halved_and_counted(monkeypatch):
    """Newton 'fails' for every step longer than a limit: the roll-out goes on with quarters of a step."""
    real, limit = module.minimise, 0.3 / 240

    def fails_when_long(equations, guess, **options):
        h = equations.coefficients.step  # 2/3 h for BDF2
        if h > limit:
            raise ConvergenceError("too long")
        return real(equations, guess, **options)

    monkeypatch.setattr(module, "minimise", fails_when_long)
    run = simulate(Scene(small_body()), Timing(frames=2, fps=60, steps_per_frame=4))
    assert run.statistics.halved_steps > 0
    fallen = (run.positions[1] - run.positions[0])[:, 2]
    assert run.times[1] == pytest.approx(1 / 60)
    # a fall by implicit Euler in quarters of h: g t²/2 (1 + h'/t), between the parabola and that bound
    t = 1 / 60
    assert (-fallen >= 0.5 * 9.81 * t**2 * 0.999).all() and (-fallen <= 0.5 * 9.81 * t**2 * (1 + 1 / 4)).all()


def test_step_that_always_fails_is_an_error(monkeypatch):
    def never(*_, **__):
        raise ConvergenceError("no descent")

    monkeypatch.setattr(module, "minimise", never)
    with pytest.raises(ConvergenceError, match=r"time step at t = 0 s failed even at h = .*: no descent"):
        simulate(Scene(small_body()), Timing(frames=2))


def test_guess_that_turns_an_element_over_is_caught():
    """The log law is infinite there: the step is halved, and the run ends where a run with short steps ends."""
    body = small_body(law="neo_hookean_log", youngs_modulus=2e4, poisson_ratio=0.3)
    nodes = np.flatnonzero(body.mesh.vertices[:, 0] == 0)
    rest = body.mesh.vertices[nodes]

    def shove(t):  # 16 cm in one step of 0.1 s, past the next row of nodes
        return rest + np.array([0.16 * min(t / 0.1, 1.0), 0.0, 0.0])

    scene = Scene(body, gravity=(0, 0, 0), node_pins=NodePins(nodes, shove), damping_time=0.02)
    run = simulate(scene, Timing(frames=2, fps=1, steps_per_frame=10))
    assert run.statistics.halved_steps > 0
    np.testing.assert_allclose(run.positions[1], body.mesh.vertices + np.array([0.16, 0, 0]), atol=2e-3)


def test_projected_matrices_are_counted():
    """A body squashed to half its length buckles: the exact matrix is indefinite there; a resting body never is."""
    body = small_body(youngs_modulus=1e6, poisson_ratio=0.3)
    squashed = body.mesh.vertices * np.array([0.5, 1.0, 1.0])
    run = simulate(Scene(body, gravity=(0, 0, 0), initial_positions=squashed), Timing(frames=2, steps_per_frame=8))
    assert 0 < run.statistics.projections < run.statistics.factorisations
    rest = simulate(Scene(body, gravity=(0, 0, 0)), Timing(frames=2, steps_per_frame=8))
    assert rest.statistics.projections == 0


def test_impossible_prescribed_motion_is_an_error():
    body = small_body(law="neo_hookean_log")
    nodes = np.arange(len(body.mesh.vertices))
    turned = NodePins(nodes, lambda t: body.mesh.vertices * ((1.0, 1.0, 1.0) if t == 0 else (1.0, 1.0, -1.0)))
    with pytest.raises(ConvergenceError, match="no finite energy"):
        simulate(Scene(body, node_pins=turned), Timing(frames=2))


# --- bad input


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frames": 0}, "frames, steps_per_frame, fps: got 0"),
        ({"fps": 0.0}, "expected > 0"),
        ({"fps": np.nan}, "expected > 0"),
        ({"steps_per_frame": 0}, "expected > 0"),
        pytest.param(
            {"integrator": "rk4"},
            "integrator: got 'rk4'; expected 'bdf2' or 'implicit_euler'",
            marks=pytest.mark.wrong_types,
        ),
        ({"friction_passes": 0}, "friction_passes: got 0"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(InputError, match=message):
        simulate(Scene(small_body()), Timing(**options))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"gravity": (0, 0)}, "gravity: got"),
        ({"initial_velocity": (0, np.nan, 0)}, "initial_velocity: got"),
        ({"damping_time": -1.0}, "damping_time: got -1.0"),
        ({"air_drag": np.inf}, "air_drag: got inf"),
        ({"initial_positions": np.zeros((2, 3))}, r"initial_positions: got shape \(2, 3\)"),
        ({"initial_velocities": np.zeros((2, 3))}, r"initial_velocities: got shape \(2, 3\)"),
    ],
)
def test_bad_scenes_are_named(fields, message):
    with pytest.raises(InputError, match=message):
        Scene(small_body(), **fields)


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ([2, -1], r"node_pins\.nodes: got -1; expected indices ≥ 0"),
        ([4, 2, 4], r"node_pins\.nodes: got node 4 2 times; expected each node once"),
        ([0, 10_000], r"node_pins\.nodes: got node 10000; expected indices below \d+, the number of nodes"),
    ],
)
def test_bad_pins_are_named(nodes, message):
    with pytest.raises(InputError, match=message):
        Scene(small_body(), node_pins=NodePins(np.array(nodes)))


@pytest.mark.wrong_types
@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ([[0, 1]], r"node_pins\.nodes: got int64 of shape \(1, 2\); expected at least one integer index"),
        ([0.0, 1.0], r"node_pins\.nodes: got float64"),
        ([True, False], r"node_pins\.nodes: got bool.*numpy\.flatnonzero"),
        ([], r"node_pins\.nodes: got float64 of shape \(0,\)"),
    ],
)
def test_pins_that_are_no_indices_are_named(nodes, message):
    with pytest.raises(InputError, match=message):
        NodePins(np.array(nodes))


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (np.zeros((3, 3)), r"node_pins\.motion: got shape \(3, 3\) at t = 0 s; expected .* \(2, 3\)"),
        (np.zeros(3), r"node_pins\.motion: got shape \(3,\)"),
        (np.full((2, 3), np.nan), r"node_pins\.motion: got values that are not finite at t = 0 s"),
    ],
)
def test_bad_targets_of_pins_are_named(target, message):
    with pytest.raises(InputError, match=message):
        Scene(small_body(), node_pins=NodePins(np.array([0, 1]), lambda t: target))


def test_targets_of_pins_that_go_bad_on_the_way_are_named():
    body = small_body()
    rest = body.mesh.vertices[:2]
    scene = Scene(body, node_pins=NodePins(np.array([0, 1]), lambda t: rest if t < 0.02 else np.full((2, 3), np.inf)))
    with pytest.raises(InputError, match=r"node_pins\.motion: got values that are not finite at t = 0\.02 s"):
        simulate(scene, Timing(frames=2, fps=10, steps_per_frame=10))


@pytest.mark.parametrize(
    ("constants", "message"),
    [
        ({"youngs_modulus": 0.0}, "youngs_modulus: got values in"),
        ({"poisson_ratio": 0.5}, "poisson_ratio: got values in"),
        ({"poisson_ratio": -1.0}, "poisson_ratio: got values in"),
        ({"density": -1.0}, "density: got values in"),
        ({"youngs_modulus": np.nan}, "youngs_modulus: got values in"),
        ({"youngs_modulus": np.ones(3)}, r"youngs_modulus: got shape \(3,\); expected a number or \[12\]"),
        ({"law": "rubber"}, "law: got 'rubber'"),
    ],
)
def test_bad_constants_are_named(constants, message):
    with pytest.raises(InputError, match=message):
        small_body(**constants)


# --- contact constants


def test_contact_stiffness_follows_the_largest_modulus_and_the_size():
    body = small_body(youngs_modulus=np.linspace(1e4, 5e4, 12))
    contact = Scene(body).contact()
    assert contact.stiffness == pytest.approx(50 * 5e4 / 0.2)
    assert Scene(body, contact_stiffness=7.0).contact().stiffness == 7.0


# --- modes


def test_free_body_has_six_rigid_modes_and_a_clamped_one_none():
    body = small_body()
    frequencies, shapes = vibration_modes(body, 8)
    assert (frequencies[:6] < 1e-3 * frequencies[6]).all() and frequencies[6] > 1.0
    assert shapes.shape == (8, len(body.mesh.vertices), 3)
    clamped = body.mesh.vertices[:, 0] == 0
    frequencies, shapes = vibration_modes(body, 3, clamped=clamped)
    assert frequencies[0] > 1.0
    assert (shapes[:, clamped] == 0).all()


def test_vibration_modes_are_orthonormal_in_mass_and_stationary():
    body = small_body(youngs_modulus=np.linspace(1e4, 5e4, 12), density=np.linspace(500, 900, 12))
    frequencies, shapes = vibration_modes(body, 9)
    gram = np.einsum("avi,vw,bwi->ab", shapes, body.mass.toarray(), shapes)
    np.testing.assert_allclose(gram, np.eye(9), atol=1e-9)
    # K φ = ω² M φ, K by differences of the force about the rest state
    rest, shape, step = body.mesh.vertices, shapes[7], 1e-6
    force = (body.gradient(rest + step * shape) - body.gradient(rest - step * shape)) / (2 * step)
    expected = (2 * np.pi * frequencies[7]) ** 2 * (body.mass @ shape)
    np.testing.assert_allclose(force, expected, atol=1e-5 * np.abs(expected).max())


def test_frequencies_scale_as_they_must():
    one, other = small_body(youngs_modulus=1e5), small_body(youngs_modulus=4e5, density=4000.0)
    larger = ElasticBody(box_mesh((0.4, 0.2, 0.2), (2, 1, 1)), youngs_modulus=4e5)
    reference = vibration_modes(one, 8)[0][6:]
    np.testing.assert_allclose(vibration_modes(other, 8)[0][6:], reference, rtol=1e-8)
    np.testing.assert_allclose(vibration_modes(larger, 8)[0][6:], reference, rtol=1e-8)


@pytest.mark.parametrize("order", [1, 2])
def test_skinning_modes_are_orthonormal_and_without_the_constant(order):
    mesh = box_mesh((0.3, 0.1, 0.1), (6, 2, 2), order=order)
    body = ElasticBody(mesh, density=np.linspace(500, 1500, len(mesh.tets)))
    weights, values = skinning_eigenmodes(body, 6)
    gram = weights.T @ body.mass @ weights
    np.testing.assert_allclose(gram, body.total_mass * np.eye(6), atol=1e-8 * body.total_mass)
    np.testing.assert_allclose(body.node_masses @ weights, 0.0, atol=1e-8 * body.total_mass)
    assert (values > 0).all() and (np.diff(values) >= 0).all()
    again, _ = skinning_eigenmodes(body, 6)
    np.testing.assert_array_equal(weights, again)


def test_first_skinning_mode_of_a_bar_is_a_cosine():
    length, e, rho = 1.0, 2e5, 800.0
    mesh = box_mesh((length, 0.1, 0.1), (10, 1, 1))
    body = ElasticBody(mesh, youngs_modulus=e, density=rho)
    weights, values = skinning_eigenmodes(body, 1)
    assert values[0] == pytest.approx(e / rho * (np.pi / length) ** 2, rel=1e-4)
    expected = np.sqrt(2) * np.cos(np.pi * mesh.vertices[:, 0] / length)
    expected *= np.sign(expected @ weights[:, 0])
    np.testing.assert_allclose(weights[:, 0], expected, atol=2e-3)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_skinning_modes_are_those_of_the_laplacian_whatever_the_isotropic_law(law):
    mesh = box_mesh((0.3, 0.2, 0.1), (3, 2, 1), order=2)
    values = [skinning_eigenmodes(ElasticBody(mesh, law=one), 3)[1] for one in ("linear", law)]
    np.testing.assert_allclose(values[1], values[0], rtol=1e-9)


@pytest.mark.parametrize(("along", "first"), [((1.0, 0, 0), 1), ((0, 2.0, 0), 0)])
def test_fibres_raise_the_skinning_modes_along_them(along, first):
    """cos(π x/L) of a box has the eigenvalue E (1 + k/4μ) (π/L)²/ρ along the fibres, without the factor across."""
    size, ratio = (0.3, 0.25, 0.05), 12.0
    law = with_fibres("neo_hookean", along, ratio)
    body = ElasticBody(box_mesh(size, (6, 5, 1), order=2), law=law, youngs_modulus=1e5, density=1000.0)
    weights, values = skinning_eigenmodes(body, 1)
    np.testing.assert_allclose(values, 1e5 / 1000 * (np.pi / size[first]) ** 2, rtol=1e-3)
    wave = np.sqrt(2.0) * np.cos(np.pi * body.mesh.vertices[:, first] / size[first])
    np.testing.assert_allclose(np.abs(weights[:, 0]), np.abs(wave), atol=0.02)


def test_stiff_inclusion_moves_as_one():
    mesh = box_mesh((0.3, 0.1, 0.1), (6, 2, 2))
    stiff = mesh.vertices[mesh.corner_tets].mean(1)[:, 0] > 0.2
    body = ElasticBody(mesh, youngs_modulus=np.where(stiff, 1e9, 1e4))
    weights, _ = skinning_eigenmodes(body, 3)
    inside = mesh.vertices[:, 0] >= 0.2
    assert (np.ptp(weights[inside], axis=0) < 1e-3 * np.ptp(weights, axis=0)).all()


@pytest.mark.parametrize("count", [-1, 10**6])
def test_bad_number_of_modes_is_named(count):
    with pytest.raises(InputError, match="count: got"):
        skinning_eigenmodes(small_body(), count)
