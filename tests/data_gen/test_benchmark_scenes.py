"""Motions of the benchmark's objects."""

import numpy as np
import pytest

from data_gen import BenchmarkMotion, BenchmarkOptions, ObjectMesh, changes_of, rolled, scene_of
from data_gen.benchmark_scenes import FRICTION, draw_motion
from physconvex import InputError
from physconvex.mesh import box_mesh

TRUTH = {"youngs_modulus": 1e6, "poisson_ratio": 0.3, "damping_time": 1e-3}


@pytest.fixture(scope="module")
def body():
    mesh = box_mesh((0.4, 0.2, 0.1), (2, 1, 1))
    vertices, faces = mesh.surface
    return mesh, ObjectMesh(vertices, faces, "box", "test")


def test_a_drop_starts_at_rest_and_draws_nothing():
    rng = np.random.default_rng(5)
    assert draw_motion("drop", 1.0, rng) == BenchmarkMotion()
    assert rng.uniform() == np.random.default_rng(5).uniform()


@pytest.mark.parametrize("seed", range(5))
def test_a_toss_spins_about_the_line_of_sight(seed):
    motion = draw_motion("toss", 0.5, np.random.default_rng(seed))
    spin = np.array(motion.spin)
    assert 3.0 <= np.linalg.norm(spin) <= 5.0
    assert abs(spin[0]) / np.linalg.norm(spin) >= np.cos(np.radians(20.0)) - 1e-12
    assert not motion.floor and motion.velocity[:2] == (0.0, 0.0)


def test_a_toss_is_back_at_its_height(body):
    mesh, shown = body
    motion = draw_motion("toss", 0.4, np.random.default_rng(0))
    x = rolled(scene_of(mesh, TRUTH, shown, motion), 5, 10.0, 8)
    masses = mesh.element_volumes / mesh.volume
    centre = np.einsum("e,tei->ti", masses, x[:, mesh.corner_tets].mean(axis=2))
    # straight-sided when undeformed; strains of about rho w^2 L^2 / 8 E = 1e-4 move the centre by less
    assert centre[-1, 2] == pytest.approx(centre[0, 2], abs=2e-3)
    assert centre[2, 2] - centre[0, 2] == pytest.approx(9.81 * 0.4**2 / 8, abs=2e-3)


def test_a_floor_that_moves_needs_a_floor(body):
    mesh, shown = body
    drop, toss = (scene_of(mesh, TRUTH, shown, BenchmarkMotion(floor=floor)) for floor in (True, False))
    assert changes_of(drop) == ("softer", "pushed", "moving_floor")
    assert changes_of(toss) == ("softer", "pushed")
    assert drop.obstacles[0].friction == FRICTION and toss.contact_points is None


def test_unknown_motions_are_named():
    with pytest.raises(InputError, match=r"roll.*drop, toss"):
        draw_motion("roll", 1.0, np.random.default_rng(0))
    with pytest.raises(InputError, match=r"roll.*drop, toss"):
        BenchmarkOptions(motion="roll")
