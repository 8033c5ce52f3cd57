"""The explicit engine of blind captures: laws of motion, and each effect in its own form."""

import numpy as np
import pytest
import torch

from data_gen.blind.engine import ExplicitWorld, _Body, run_explicit
from physconvex import ConvergenceError
from physconvex.dynamics import Timing, simulate
from physconvex.fem import ElasticBody, NodePins, Scene
from physconvex.materials import get_law, with_strain_stiffening
from physconvex.mesh import Embedding, box_mesh

MESH = box_mesh((0.2, 0.1, 0.1), (4, 2, 2), order=1)
POINTS = MESH.vertices[[0, 5, 20, -1]]


def world(**changes):
    start = {"floor": float(MESH.vertices[:, 2].min()), "velocity": (0.5, 0.0, -1.0)}
    return ExplicitWorld(MESH, 4e4, 0.3, 1000.0, **(start | changes))


def run(frames=13, **changes):
    return run_explicit(world(**changes), POINTS, frames=frames, fps=100.0)


@pytest.fixture(scope="module")
def plain():
    return run()


def test_free_fall_is_a_parabola():
    motion = run_explicit(world(floor=None), MESH.vertices, frames=13, fps=100.0)
    expected = np.array([0.5, 0, -1.0]) * motion.times[:, None] + np.array([0, 0, -4.905]) * motion.times[:, None] ** 2
    moved = (motion.positions - motion.rest).mean(1)
    np.testing.assert_allclose(moved, expected, atol=1e-3)  # first-order steps


def test_momentum_is_kept_without_forces():
    still = world(floor=None, gravity=(0.0, 0.0, 0.0), spin=(0.0, 3.0, 0.0))
    motion = run_explicit(still, MESH.vertices, frames=9, fps=100.0)
    np.testing.assert_allclose(motion.velocities[-1].mean(0), [0.5, 0.0, -1.0], atol=5e-3)
    assert np.linalg.norm(motion.positions[-1, 0] - motion.positions[-1, -1]) == pytest.approx(np.sqrt(0.06), rel=0.03)


def test_it_bounces_without_sinking_in(plain):
    assert plain.positions[..., 2].min() > -0.01 and plain.velocities[..., 2].mean(1).max() > 0.3


@pytest.mark.parametrize(
    "changes",
    [{"damping_time": 3e-3}, {"contact_damping": 5e-3}, {"yield_stress": 1e3}, {"branch": (1.0, 6e-3)}],
    ids=["damping", "restitution", "plasticity", "viscoelasticity"],
)
def test_what_dissipates_lowers_the_rebound(plain, changes):
    assert run(**changes).velocities[:, :, 2].mean(1).max() < plain.velocities[:, :, 2].mean(1).max() - 0.02


def test_friction_slows_and_drag_brakes(plain):
    assert run(friction=0.3).velocities[-1, :, 0].mean() < plain.velocities[-1, :, 0].mean() - 0.05
    flight = run(floor=None, drag_rate=1.0)
    assert flight.velocities[-1, :, 0].mean() < 0.5 - 0.02


def test_yielding_leaves_a_dent(plain):
    def length(motion):
        return np.linalg.norm(motion.positions[-1, 0] - motion.positions[-1, 3])

    assert abs(length(run(frames=25, yield_stress=1e3)) - length(run(frames=25))) > 2e-4


def test_held_nodes_stay():
    held = np.flatnonzero(MESH.vertices[:, 0] < 1e-9)
    motion = run_explicit(world(held=held, floor=None, velocity=(0, 0, 0)), MESH.vertices, frames=5, fps=100.0)
    np.testing.assert_array_equal(motion.positions[-1, held], MESH.vertices[held])
    assert motion.positions[-1, -1, 2] < MESH.vertices[-1, 2] - 1e-4


def test_too_stiff_a_dashpot_is_refused():
    with pytest.raises(ConvergenceError, match="steps per frame"):
        run(contact_damping=50.0)


def test_a_beam_sways_as_the_full_order_model_has_it():
    """Linear tetrahedra of this size are 9 % too stiff (ν = .41); smoothed ones are not, and lose no volume to it."""
    mesh = box_mesh((0.24, 0.06, 0.06), (16, 4, 4), order=1)
    held = np.flatnonzero(mesh.vertices[:, 0] < 1e-9)
    points = mesh.vertices[mesh.vertices[:, 0] > 0.239]
    ours = run_explicit(ExplicitWorld(mesh, 1e5, 0.41, 1000.0, held=held), points, frames=13, fps=60.0)
    fine = box_mesh((0.24, 0.06, 0.06), (12, 3, 3), order=2)
    body = ElasticBody(fine, youngs_modulus=1e5, poisson_ratio=0.41, density=1000.0)
    scene = Scene(body, node_pins=NodePins(np.flatnonzero(fine.vertices[:, 0] < 1e-9)))
    reference = simulate(scene, Timing(frames=13, fps=60.0, steps_per_frame=16))
    theirs = Embedding.of_points(fine, points).apply(reference.positions)
    sway, apart = theirs[:, :, 2] - theirs[0, :, 2], ours.positions - theirs
    assert np.ptp(sway) > 0.03
    assert np.sqrt((apart**2).sum(-1).mean()) < 0.03 * np.ptp(sway)


@pytest.mark.parametrize("stiffening", [0.0, 8.0])
def test_small_strain_gives_the_stress_of_linear_elasticity(stiffening):
    """Virtual work of a uniform strain: Σ f Xᵀ = −V σ; what stiffens with strain leaves E and ν."""
    body = _Body(world(floor=None, gravity=(0.0, 0.0, 0.0), stiffening=stiffening))
    strain = 1e-6 * np.array([[1.0, 0.3, 0.0], [0.3, -0.5, 0.2], [0.0, 0.2, 0.4]])
    x = MESH.vertices @ (np.eye(3) + strain)
    work = (body.accelerations(x, np.zeros_like(x), 0.0) * body.masses[:, None]).T @ MESH.vertices
    stress = 2 * 4e4 / 2.6 * strain + 4e4 * 0.3 / 1.3 / 0.4 * np.trace(strain) * np.eye(3)
    np.testing.assert_allclose(work, -0.2 * 0.1 * 0.1 * stress, atol=1e-4 * 2e-3 * np.abs(stress).max())


def test_stiffening_starts_as_yeohs_term_does():
    """μ/2b (exp(b q) − 1 − b q) = μ b/4 q² + …, of which the dictionary's rate μ/2 q² is a half of b."""
    strain, rate = 0.02 * np.array([[1.0, 0.5, 0.0], [-0.4, -0.6, 0.3], [0.0, 0.2, -1.0]]), 1.5
    x = MESH.vertices @ (np.eye(3) + strain).T

    def stress(stiffening):
        body = _Body(world(floor=None, gravity=(0.0, 0.0, 0.0), stiffening=stiffening))
        return -(body.accelerations(x, np.zeros_like(x), 0.0) * body.masses[:, None]).T @ MESH.vertices / 2e-3

    f = torch.eye(3, dtype=torch.float64) + torch.as_tensor(strain)
    mu, lam = (torch.tensor(v, dtype=torch.float64) for v in (4e4 / 2.6, 4e4 * 0.3 / 1.3 / 0.4))
    ground = get_law("neo_hookean")
    added = (with_strain_stiffening(ground, rate).stress(f, mu, lam) - ground.stress(f, mu, lam)).numpy()
    np.testing.assert_allclose(stress(2 * rate) - stress(0.0), added, atol=0.02 * np.abs(added).max())


def test_the_step_is_just_below_the_stability_limit():
    """The highest frequency by power iteration, beside that of the assembled matrix."""
    body = _Body(world(floor=None, gravity=(0.0, 0.0, 0.0)))
    count, tiny = 3 * len(MESH.vertices), 1e-7
    columns = [
        (body.accelerations(MESH.vertices + tiny * unit.reshape(-1, 3), 0 * MESH.vertices, 0.0) / tiny).ravel()
        for unit in np.eye(count)
    ]
    fastest = np.sqrt(np.abs(np.linalg.eigvals(np.stack(columns))).max())
    assert fastest < body._fastest() < 1.1 * fastest
