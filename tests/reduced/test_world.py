"""Several bodies: forces between them, momentum, collisions, stacks, friction."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from physconvex import InputError
from physconvex.dynamics import Contact, Plane, Timing, simulate
from physconvex.fem import ElasticBody
from physconvex.mesh import TetMesh, box_mesh, to_quadratic
from physconvex.reduced import (
    BodySamples,
    ReducedBodies,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    Shell,
    eigenmode_weights,
)
from physconvex.reduced.bodies_equations import BodiesEquations
from physconvex.reduced.pair_contact import PairContact

EDGE = 0.1


def block(shift=(0.0, 0.0, 0.0), *, cells=(2, 2, 2), size=(EDGE,) * 3, **scene) -> ReducedScene:
    """A box about the origin, moved."""
    mesh = box_mesh(size, cells, order=2)
    return scene_of(mesh.vertices - 0.5 * np.asarray(size) + np.asarray(shift), mesh.tets, **scene)


def scene_of(vertices, tets, *, modulus=1e5, count=3, mirrored=False, **scene) -> ReducedScene:
    """A reduced body of these tetrahedra, or their mirror image in the plane x = 0."""
    if mirrored:  # corners 0 and 1 change places, and so do the nodes of the edges that meet there
        vertices, tets = vertices * [-1, 1, 1], tets[:, [1, 0, 2, 3, 4, 6, 5, 8, 7, 9]]
    mesh = TetMesh(vertices, tets)
    space = ReducedSpace(eigenmode_weights(ElasticBody(mesh), count), BodySamples.of_mesh(mesh))
    body = ReducedBody(space, youngs_modulus=modulus, poisson_ratio=0.3)
    return ReducedScene(body, **({"gravity": (0, 0, 0)} | scene))


def momenta(world: ReducedBodies, run, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Momentum [N s] and angular momentum about the origin [N m s] of all bodies."""
    linear, angular = np.zeros(3), np.zeros(3)
    for scene, body in zip(world.scenes, run.bodies, strict=True):
        y, v = body.coordinates[frame], body.velocities[frame]
        linear += scene.body.first_moments @ v
        angular += np.einsum("ab,abi->i", scene.body.mass, np.cross(y[:, None], v[None]))
    return linear, angular


def test_shell_is_the_boundary_of_the_mesh():
    mesh = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=2)
    shell = Shell.of_mesh(mesh)
    corners = shell.points[shell.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert areas.sum() == pytest.approx(0.22) and np.linalg.det(corners).sum() / 6 == pytest.approx(0.006)
    with pytest.raises(InputError, match="normals outwards"):
        Shell(shell.points, shell.faces[:, ::-1])


def overlapping() -> tuple[ReducedBodies, np.ndarray]:
    """Two deformed blocks, one corner of the second one inside the first."""
    first, second = block(cells=(2, 1, 1)), block((0.08, 0.07, 0.085), cells=(1, 2, 1), modulus=3e5)
    rng = np.random.default_rng(1)
    world = ReducedBodies((first, second), friction=0.4)
    y = np.concatenate([scene.start + 1e-3 * rng.normal(size=scene.start.shape) for scene in world.scenes])
    return world, y


def test_inside_of_a_jagged_shell_is_where_it_winds_round():
    """Saddles and spikes; truth: the solid angle of all triangles (Van Oosterom & Strackee 1983) is 4π inside."""
    sphere, rng = trimesh.creation.icosphere(subdivisions=2), np.random.default_rng(9)
    vertices = sphere.vertices * rng.uniform(0.5, 1.5, (len(sphere.vertices), 1))
    points = rng.uniform(-1.2, 1.2, (4000, 3))
    a, b, c = (vertices[sphere.faces[:, k]] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    angle = 2 * np.arctan2((a * np.cross(b, c)).sum(-1), below).sum(1)
    law = Contact((), np.ones(len(points)), 1.0, 1.0, 1.0)
    contact = PairContact(law, 0.0, np.eye(len(points)), np.eye(len(vertices)), sphere.faces, reach=0.01)
    touch = contact.touching(np.vstack([points, vertices]))
    np.testing.assert_array_equal(np.sort(touch.samples), np.flatnonzero(angle > 2 * np.pi))
    assert 200 < len(touch.samples) < 3800


def test_points_inside_are_those_of_all_triangles_however_the_bodies_came_there():
    """Lists of near triangles that are kept while two bodies deform, turn and pass through each other."""
    scenes = (block(), block((0.9 * EDGE, 0.2 * EDGE, 0.1 * EDGE)))
    world, rng = ReducedBodies(scenes), np.random.default_rng(4)
    kept = [(pair, np.r_[world.slices[a], world.slices[b]]) for a, b, pair in world.pairs()]
    y = np.concatenate([scene.body.rest for scene in scenes])
    drift, found = 0.0005 * EDGE * rng.normal(size=y.shape), 0
    drift[world.slices[1]] += 0.01 * (scenes[0].body.rest - scenes[1].body.rest)[: len(y) - len(scenes[0].body.rest)]
    for step in range(60):
        y = y + drift * np.sin(0.3 * step + 0.5) + 1e-4 * EDGE * rng.normal(size=y.shape)
        for pair, where in kept:
            fresh = PairContact(pair.law, 0.0, pair.samples, pair.shell, pair.faces, reach=10.0)
            ours, all_of_them = pair.touching(y[where]), fresh.touching(y[where])
            np.testing.assert_array_equal(ours.samples, all_of_them.samples)
            np.testing.assert_allclose(ours.depth, all_of_them.depth, atol=1e-12 * EDGE)
            found += len(ours.samples)
    assert found > 200


def test_force_between_bodies_is_the_derivative_of_their_energy():
    world, y = overlapping()
    pairs, rng = BodiesEquations(world).pairs, np.random.default_rng(2)
    touched = 0
    for pair in pairs:
        energy, gradient = pair.contact.energy_and_gradient(y)
        touched += energy > 0
        direction = rng.normal(size=y.shape)
        ahead, behind = (pair.contact.energy_and_gradient((y + s * direction)[pair.where])[0] for s in (1e-8, -1e-8))
        mine = float((pair.contact.energy_and_gradient(y[pair.where])[1] * direction[pair.where]).sum())
        assert mine == pytest.approx((ahead - behind) / 2e-8, rel=1e-5, abs=1e-9)
        assert gradient.shape == y.shape
    assert touched


def test_force_and_reaction_are_equal_and_on_one_line():
    world, y = overlapping()
    rests = np.concatenate([scene.body.space.affine(np.zeros((3, 3)), np.array([1.0, 0, 0])) for scene in world.scenes])
    one = rests[:, 0]  # coordinates of the field that is one everywhere
    found = 0.0
    for pair in BodiesEquations(world).pairs:
        _, gradient = pair.contact.energy_and_gradient(y[pair.where])
        size = np.abs(gradient).max()
        found = max(found, size)
        np.testing.assert_allclose(one[pair.where] @ gradient, 0, atol=1e-12 * size)
        np.testing.assert_allclose(np.cross(y[pair.where], gradient).sum(0), 0, atol=1e-12 * size)
    assert found > 0


def test_hessian_of_touching_bodies_against_differences_without_the_turning_normal():
    """Two faces in even contact: normals do not turn, and the Hessian is exact in the normal direction."""
    world = ReducedBodies((block(), block((0, 0, EDGE - 1e-3), size=(0.06,) * 3)))
    equations = BodiesEquations(world)
    y = np.concatenate([scene.start for scene in world.scenes])
    direction = np.concatenate(
        [
            s.body.space.affine(np.diag([0.0, 0.0, a]), np.array([0.0, 0.0, b]))
            for s, a, b in zip(world.scenes, (1, 0.3), (0, 1), strict=True)
        ]
    )
    matrix = equations.hessian(y, project=False)
    ahead, behind = (equations.evaluate(y + s * direction)[1] for s in (1e-7, -1e-7))
    expected = (ahead - behind) / 2e-7
    np.testing.assert_allclose(
        (matrix @ direction.ravel()).reshape(y.shape), expected, atol=1e-5 * np.abs(expected).max()
    )


def test_collision_in_free_space_keeps_momentum_and_gains_no_energy():
    first = block((-0.08, 0, 0), initial_velocity=(0.8, 0, 0.1))
    second = block((0.05, 0.03, 0.02), cells=(2, 1, 1), modulus=2e5, initial_angular_velocity=(0, 2, 3))
    world = ReducedBodies((first, second))
    run = simulate(world, Timing(frames=9, fps=48, steps_per_frame=16))
    before, after = momenta(world, run, 0), momenta(world, run, -1)
    mass = first.body.total_mass
    assert first.body.first_moments @ run.bodies[0].velocities[-1, :, 0] < 0.5 * 0.8 * mass  # it was hit
    np.testing.assert_allclose(after[0], before[0], atol=1e-5 * np.linalg.norm(before[0]))
    # BDF2 keeps the angular momentum of a turning body to second order only
    np.testing.assert_allclose(after[1], before[1], atol=0.01 * np.linalg.norm(before[1]))

    def energy(frame: int) -> float:
        return sum(
            s.body.energy(b.coordinates[frame])
            + 0.5 * float(np.einsum("ai,ab,bi->", b.velocities[frame], s.body.mass, b.velocities[frame]))
            for s, b in zip(world.scenes, run.bodies, strict=True)
        )

    assert 0.5 * energy(0) < energy(-1) < 1.001 * energy(0)


def pad(*, mirrored: bool = False, **scene) -> ReducedScene:
    """A block left of the plane x = 0 whose near face bulges a little, or its mirror image."""
    size = np.array([EDGE, 0.9 * EDGE, 0.75 * EDGE])  # no two equal edges: no eigenmode has a twin
    mesh = box_mesh(tuple(size), (2, 4, 4), order=1)
    x, y, z = (mesh.vertices - 0.5 * size).T
    x = x - 0.5 * EDGE - 0.05 * EDGE * (y**2 + z**2) / (0.5 * EDGE) ** 2 * (0.5 + x / EDGE)
    quadratic = to_quadratic(TetMesh(np.column_stack([x - 1e-3, y, z]), mesh.tets))
    return scene_of(quadratic.vertices, quadratic.tets, mirrored=mirrored, **scene)


def test_collision_with_the_mirror_image_is_that_with_a_smooth_wall():
    timing = Timing(frames=5, fps=24, steps_per_frame=8)
    alone = pad(obstacles=(Plane(normal=(-1, 0, 0)),), initial_velocity=(0.2, 0.0, 0.0))
    image = pad(mirrored=True, initial_velocity=(-0.2, 0.0, 0.0))
    both = simulate(ReducedBodies((replace(alone, obstacles=()), image)), timing)
    wall = simulate(alone, timing)
    points = alone.body.space.samples.surface_points
    expected = wall.positions(points)
    travel = expected[:, :, 0].mean(1)
    assert travel[-1] < travel[1] - 0.01  # it has bounced
    first, second = both.bodies[0].positions(points), both.bodies[1].positions(points * [-1, 1, 1])
    np.testing.assert_allclose(second, first * [-1, 1, 1], atol=1e-9)
    assert np.linalg.norm(first - expected, axis=2).max() < 1e-3 * EDGE


def test_two_stacked_blocks_rest_at_the_height_of_springs_in_a_row():
    down = {"gravity": (0, 0, -9.81), "damping_time": 0.02, "contact_damping": 0.01}
    floor = (Plane(point=(0, 0, -EDGE / 2), friction=0.5),)
    lower = block(modulus=2e5, obstacles=floor, **down)
    upper = block((0, 0, EDGE), modulus=2e5, obstacles=floor, **down)
    run = simulate(ReducedBodies((lower, upper), friction=0.5), Timing(frames=13, fps=24, steps_per_frame=8))
    still = max(np.abs(b.velocities[-1]).max() for b in run.bodies)
    assert still < 2e-3
    kc, weight, e = 50 * 2e5 / EDGE, 1000 * 9.81 * EDGE, 2e5  # pressure of one block
    eps = 5e-4 * EDGE
    under = [2 * weight / kc + eps / 2, weight / (kc / 2) + 2 * eps / 2]  # depth below the floor, and into each other
    squeeze = [1.5 * weight / e * EDGE, 0.5 * weight / e * EDGE]
    top = -EDGE / 2 - under[0] + EDGE - squeeze[0] - under[1] + EDGE - squeeze[1]
    point = np.array([[0.0, 0.0, 1.5 * EDGE]])
    # the smooth stretch of friction lets the blocks widen freely only in part
    assert run.bodies[1].positions(point)[-1, 0, 2] == pytest.approx(top, abs=0.1 * (sum(squeeze) + sum(under)))


def test_a_block_slides_on_another_one_by_the_friction_between_them():
    down = {"gravity": (9.81 * np.sin(0.5), 0, -9.81 * np.cos(0.5))}
    fixed = block(cells=(4, 2, 1), size=(0.4, 0.2, 0.1), modulus=1e7, count=1, gravity=(0, 0, 0))
    found = []
    for friction in (0.2, 1.0):
        rider = block(
            (-0.1, 0, 0.08), cells=(1, 1, 1), size=(0.06,) * 3, modulus=3e5, count=1, damping_time=5e-3, **down
        )
        heavy = replace(fixed, body=fixed.body.with_material(density=1e6))
        run = simulate(ReducedBodies((heavy, rider), friction=friction), Timing(frames=9, fps=48, steps_per_frame=4))
        found.append(rider.body.first_moments @ run.bodies[1].velocities[:, :, 0].T / rider.body.total_mass)
    expected = 9.81 * (np.sin(0.5) - 0.2 * np.cos(0.5))
    assert (found[0][-1] - found[0][2]) / (6 / 48) == pytest.approx(expected, rel=0.03)
    assert abs(found[1][-1]) < 0.02


def test_a_body_without_shell_is_refused():
    scene = block()
    samples = replace(scene.body.space.samples, shell=None)
    bare = replace(scene, body=ReducedBody(ReducedSpace(scene.body.space.field, samples)))
    with pytest.raises(InputError, match="no shell"):
        ReducedBodies((scene, bare))
    with pytest.raises(InputError, match="not symmetric"):
        ReducedBodies((scene, scene), friction=np.array([[0.0, 0.1], [0.2, 0.0]]))
