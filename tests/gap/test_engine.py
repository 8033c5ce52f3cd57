"""The explicit engine of blind captures: laws of motion, and each effect in its own form."""

import numpy as np
import pytest

from physconvex.errors import ConvergenceError
from physconvex.fem import box_mesh
from physconvex.gap.blind.engine import World, run_explicit

MESH = box_mesh((0.2, 0.1, 0.1), (4, 2, 2), order=1)
POINTS = MESH.vertices[[0, 5, 20, -1]]


def world(**changes):
    start = {"floor": float(MESH.vertices[:, 2].min()), "velocity": (0.5, 0.0, -1.0)}
    return World(MESH, 4e4, 0.3, 1000.0, **(start | changes))


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
