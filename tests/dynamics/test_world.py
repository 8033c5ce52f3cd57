"""Everything a world states acts on a reduced body and on finite elements alike, or is refused by name."""

from dataclasses import fields, replace

import numpy as np
import pytest

from physconvex import InputError
from physconvex.dynamics import HangingLoad, Loads, Pins, Plane, Timing, Wind, World, in_world, simulate
from physconvex.fem import ElasticBody, Scene
from physconvex.mesh import TetMesh, box_mesh
from physconvex.reduced import BodySamples, NodalWeights, ReducedBody, ReducedScene, ReducedSpace

SIZE = (0.2, 0.1, 0.1)
MESH = box_mesh(SIZE, (2, 1, 1), order=1)
CONSTANTS = {"youngs_modulus": 2e5, "poisson_ratio": 0.3, "density": 900.0}
TIMING = Timing(frames=7, fps=60.0, steps_per_frame=4, tolerance=1e-9)
FLOOR = Plane(point=(0, 0, -0.004), friction=0.3, velocity=(0.3, 0.0, 0.0))
TOP = MESH.vertices[MESH.vertices[:, 2] > 0.09]
FACE = MESH.vertices[MESH.vertices[:, 0] < 1e-9]
# a slab that falls onto a moving floor, turning: every field has something to act on
USUAL = World(
    obstacles=(FLOOR,), initial_velocity=(0.1, 0.0, -0.5), initial_angular_velocity=(0.5, 1.0, 0.2), damping_time=1e-3
)
OTHER = {
    "obstacles": (replace(FLOOR, friction=0.9),),
    "gravity": (0.5, 0.0, -7.0),
    "push": lambda time: (0.0, 20.0 * time, 1.0),
    "damping_time": 2e-2,
    "air_drag": 3.0,
    "wind": Wind((0.0, 8.0, 0.0)),
    "loads": Loads(TOP + np.array([0.003, 0.0, -0.002]), np.tile([0.3, 0.0, -0.4], (len(TOP), 1))),
    "pins": Pins(FACE, SIZE[1] * SIZE[2] / len(FACE), stiffness=1e9),
    "initial_orientation": (0.0, 0.1, 0.2),
    "initial_velocity": (0.0, 0.2, -0.6),
    "initial_angular_velocity": (0.0, -1.0, 0.0),
    "contact_stiffness": 2e7,
    "contact_smoothing": 1e-3,
    "slip_velocity": 0.2,
    "contact_damping": 5e-3,
}


def nodal_weights(mesh: TetMesh) -> NodalWeights:
    """The nodes' shape functions."""
    count = len(mesh.vertices)
    return NodalWeights(mesh, np.eye(count)[:, : count - 1])


@pytest.fixture(scope="module")
def reduced_body() -> ReducedBody:
    """With all displacements of the mesh."""
    space = ReducedSpace(nodal_weights(MESH), BodySamples.of_mesh(MESH), interpolated=True)
    return ReducedBody(space, **CONSTANTS)


def moved(body: ReducedBody, world: World) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the nodes, reduced and full."""
    full = in_world(Scene, ElasticBody(MESH, **CONSTANTS), world)
    reduced = simulate(in_world(ReducedScene, body, world), TIMING).positions(MESH.vertices)
    return reduced, simulate(full, TIMING).positions


def test_every_field_is_tried():
    assert {field.name for field in fields(World)} == {*OTHER, "hanging"}


@pytest.fixture(scope="module")
def usual(reduced_body) -> tuple[np.ndarray, np.ndarray]:
    return moved(reduced_body, USUAL)


@pytest.mark.parametrize("name", sorted(OTHER))
def test_a_field_changes_both_motions_alike(name, reduced_body, usual):
    before = usual
    after = moved(reduced_body, replace(USUAL, **{name: OTHER[name]}))
    changes = [b - a for a, b in zip(before, after, strict=True)]
    size = np.abs(changes[1]).max()
    assert size > 1e-5
    # the reduced body has all displacements of the mesh; but springs take a part of a step to stop what moves
    assert np.abs(changes[0] - changes[1]).max() < (0.1 if name == "pins" else 1e-4) * size


def test_a_hanging_load_acts_on_finite_elements_and_is_refused_of_reduced_bodies(reduced_body):
    world = replace(USUAL, hanging=HangingLoad(TOP, np.full(len(TOP), 0.2)))
    full = in_world(Scene, ElasticBody(MESH, **CONSTANTS), world)
    plain = in_world(Scene, full.body, USUAL)
    assert np.abs(simulate(full, TIMING).positions - simulate(plain, TIMING).positions).max() > 1e-5
    with pytest.raises(InputError, match="hanging: got a load that hangs on a reduced body"):
        in_world(ReducedScene, reduced_body, world)


def test_what_a_scene_has_otherwise():
    scene = in_world(Scene, ElasticBody(MESH, **CONSTANTS), USUAL, gravity=(0.0, 0.0, 0.0))
    assert scene.gravity == (0.0, 0.0, 0.0) and scene.obstacles == (FLOOR,)


def test_finite_elements_hold_nodes_alone():
    with pytest.raises(InputError, match=r"pins\.points: one lies 0\.01 m from the nearest node"):
        Scene(ElasticBody(MESH, **CONSTANTS), pins=Pins(FACE + np.array([0.01, 0.0, 0.0]), 1e-3))
