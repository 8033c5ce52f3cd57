"""Where a body lands, against a simulation; and the nodes that it gets there."""

import numpy as np

from data_gen import refine_at_landing
from data_gen.landing import landing_heights
from physconvex.dynamics import Timing, World, simulate
from physconvex.fem import ElasticBody, Scene
from physconvex.mesh import TetMesh, box_mesh


def turning_bar() -> TetMesh:
    mesh = box_mesh((0.6, 0.2, 0.1), (3, 1, 1), order=2)
    return TetMesh(mesh.vertices + np.array([0.0, 0.0, 0.7]), mesh.tets)


def test_heights_at_landing_are_those_of_a_stiff_body_in_flight():
    mesh, speed, spin = turning_bar(), (0.4, 0.0, -0.5), (1.5, -2.0, 1.0)
    heights = landing_heights(mesh, World(initial_velocity=speed, initial_angular_velocity=spin))
    scene = Scene(ElasticBody(mesh, youngs_modulus=1e8), initial_velocity=speed, initial_angular_velocity=spin)
    flight = simulate(scene, Timing(frames=500, fps=1000.0, steps_per_frame=1, tolerance=1e-9)).positions[..., 2]
    landed = int(np.argmax(flight.min(axis=1) <= 0.0))
    assert landed > 100
    np.testing.assert_allclose(heights, np.maximum(flight[landed], 0.0), atol=6e-3)  # 1 ms at 4 m/s and second order
    assert heights.argmin() == flight[landed].argmin()


def test_what_does_not_land_is_left_alone():
    mesh, still = turning_bar(), World(gravity=(0.0, 0.0, 0.0))
    assert landing_heights(mesh, still) is None
    assert refine_at_landing(mesh, 100, still) is mesh
    assert refine_at_landing(mesh, 0, World()) is mesh


def test_nodes_are_added_where_it_lands():
    mesh = turning_bar()
    fine = refine_at_landing(mesh, 120, World(initial_angular_velocity=(0.0, 2.0, 0.0)))
    assert len(mesh.vertices) + 90 < len(fine.vertices) <= len(mesh.vertices) + 120
    added = fine.vertices[len(np.unique(mesh.corner_tets)) :]
    assert (added[:, 0] > 0.3).mean() > 0.7  # its right end comes first
    np.testing.assert_allclose(fine.volume, mesh.volume, rtol=1e-12)
