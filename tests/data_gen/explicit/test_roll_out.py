"""Roll-outs against rigid flight, the implicit full-order simulator, and each other."""

import numpy as np
import pytest
import torch

from data_gen import falling_body, lay_out, roll_out
from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody, Scene
from physconvex.mesh import TetMesh

FRAMES = 11


def implicit(given, mesh, steps_per_frame=48):
    """Positions of the same drop by BDF2, with the masses in the nodes as the explicit steps have them."""
    masses = lay_out([falling_body(given, mesh)]).nodes[:, 0].astype(np.float64)
    scene = Scene(
        ElasticBody(
            TetMesh(given.placed(mesh.vertices), mesh.tets, mass_shares=masses / masses.sum()),
            youngs_modulus=given.youngs_modulus,
            poisson_ratio=given.poisson_ratio,
            density=given.density,
        ),
        obstacles=(Plane(friction=given.friction),),
        damping_time=given.damping_time,
        initial_velocity=given.initial_velocity,
        initial_angular_velocity=given.initial_angular_velocity,
    )
    return simulate(scene, Timing(frames=FRAMES, steps_per_frame=steps_per_frame, contact_solver="condensed")).positions


def explicit(given, mesh):
    """Positions by the explicit roll-out."""
    layout = lay_out([falling_body(given, mesh)], frames=FRAMES)
    return layout.positions(roll_out(layout).numpy(), 0)


def test_masses_and_areas_are_the_bodys(body):
    layout = lay_out([body])
    assert layout.nodes[:, 0].sum() == pytest.approx(1000 * 0.5**3, rel=1e-6)
    assert layout.nodes[:, 1].sum() == pytest.approx(6 * 0.5**2, rel=1e-6)


def test_until_it_lands_it_flies_as_a_rigid_body(drop, box):
    given = drop(0.4, initial_velocity=(0.3, -0.2, 0.1), initial_angular_velocity=(0.0, 0.0, 1.5))
    mesh = box(1)
    layout = lay_out([falling_body(given, mesh)], frames=FRAMES)
    first = layout.table[0, 4]
    assert first >= 4
    shown = layout.positions(layout.out, 0)
    for frame in range(first + 1):
        time = frame / 24
        angle = 1.5 * time
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        centre = given.shift + time * np.array([0.3, -0.2, 0.1]) + [0, 0, -0.5 * 9.81 * time**2]
        assert shown[frame] == pytest.approx(mesh.vertices @ turn.T + centre, abs=1e-5)
    assert (shown[first + 1 :] == 0).all()


@pytest.mark.parametrize(
    "changes",
    [{}, {"friction": 0.6, "initial_velocity": (0.4, 0.0, 0.0)}, {"youngs_modulus": 5e5, "poisson_ratio": 0.45}],
    ids=["dropped", "sliding", "stiff"],
)
def test_it_moves_as_the_implicit_simulator_says(drop, box, changes):
    given, mesh = drop(**changes), box()
    found, wanted = explicit(given, mesh), implicit(given, mesh)
    moved = np.sqrt(((wanted[-1] - wanted[0]) ** 2).sum(axis=1).mean())
    error = np.sqrt(((found - wanted) ** 2).sum(axis=2).mean(axis=1)).max()
    assert error < 0.01 * moved


def test_a_stiffer_body_moves_otherwise(drop, box):
    """The tolerance above can tell it."""
    wanted = implicit(drop(), box())
    found = explicit(drop(youngs_modulus=7e4), box())
    moved = np.sqrt(((wanted[-1] - wanted[0]) ** 2).sum(axis=1).mean())
    assert np.sqrt(((found - wanted) ** 2).sum(axis=2).mean(axis=1)).max() > 0.03 * moved


def test_bodies_do_not_see_each_other(body, drop, box):
    other = falling_body(drop(0.2, youngs_modulus=2e5), box(1))
    both = lay_out([body, other], frames=FRAMES)
    together = roll_out(both).numpy()
    for number, one in enumerate((body, other)):
        alone = lay_out([one], frames=FRAMES)
        assert np.array_equal(both.positions(together, number), alone.positions(roll_out(alone).numpy(), 0))


def test_more_caution_is_shorter_steps(body):
    usual, careful = lay_out([body]), lay_out([body], caution=3.0)
    assert careful.table[0, 8] == 3 * usual.table[0, 8]
    assert careful.materials[0, 7] == pytest.approx(usual.materials[0, 7] / 3)


def test_the_kernel_leaves_the_processors_arithmetic_as_it_was(body):
    """A library linked for fast mathematics would have the process take the smallest numbers for zero from then on."""
    roll_out(lay_out([body], frames=1))
    smallest = np.array([5e-324, 1e-310])
    assert (smallest * np.array([1.0, 0.5]) > 0).all()


@pytest.mark.gpu
def test_a_gpu_moves_them_as_the_processor_does(body, drop, box):
    layout = lay_out([body, falling_body(drop(0.2, friction=0.5), box())], frames=FRAMES)
    processor, device = roll_out(layout), roll_out(layout, "cuda").cpu()
    assert torch.allclose(processor, device, atol=1e-4)
