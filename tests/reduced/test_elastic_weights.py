"""Weights from vibrations and from answers to forces."""

import dataclasses

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from physconvex import InputError
from physconvex.dynamics import Pins, Plane, Sphere, Timing, simulate
from physconvex.fem import (
    ElasticBody,
    NodePins,
    Scene,
    elastic_responses,
    rigid_motions,
    tangent_stiffness,
    vibration_modes,
)
from physconvex.mesh import TetMesh, box_mesh
from physconvex.reduced import (
    BodySamples,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    eigenmode_weights,
    elastic_weights,
    even_loads,
    held_nodes,
    touched_loads,
    with_elastic_weights,
)
from physconvex.reduced.scene_weights import most_deformed


@pytest.fixture(scope="module")
def bar() -> ElasticBody:
    return ElasticBody(box_mesh((0.3, 0.1, 0.1), (4, 2, 2), order=2), youngs_modulus=1e5, poisson_ratio=0.4)


def linear(body: ElasticBody, field) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shape functions at the nodes as columns, and the stiffness and mass that they give."""
    space = ReducedSpace(field, BodySamples.of_mesh(body.mesh), interpolated=True)
    columns = np.kron(space.shape_values(body.mesh.vertices), np.eye(3))
    mass = sp.kron(body.mass, sp.eye(3))
    return columns, columns.T @ (tangent_stiffness(body) @ columns), columns.T @ (mass @ columns)


def test_answer_to_a_pulled_end_is_a_parabola_with_half_a_joule():
    """Carried by its inertia, without lateral strain: E A u'' = ρ A a."""
    mesh = box_mesh((1.0, 0.1, 0.1), (6, 1, 1), order=2)
    body = ElasticBody(mesh, youngs_modulus=2e5, poisson_ratio=0.0)
    end = np.isclose(mesh.vertices[:, 0], 1.0)
    faces = mesh.boundary_faces[end[mesh.boundary_faces].all(1)]
    forces = np.zeros((1, len(mesh.vertices), 3))
    np.add.at(forces[0, :, 0], faces[:, 3:].ravel(), 1 / 3)
    answer = elastic_responses(body, forces)[0]
    parabola = mesh.vertices[:, 0] ** 2 - 1 / 3
    scale = 1 / np.sqrt(2e5 * 0.01 * 4 / 3)  # ∫ E A u'² = 1 for u' = 2 x
    np.testing.assert_allclose(answer[:, 0], scale * parabola, atol=1e-5 * scale)
    np.testing.assert_allclose(answer[:, 1:], 0, atol=1e-5 * scale)
    flat = answer.ravel()
    assert flat @ tangent_stiffness(body) @ flat == pytest.approx(1.0, rel=1e-5)


def test_answers_and_vibrations_about_a_stretched_state_are_those_of_its_forces(bar):
    """The forces of the body itself, differenced; at rest the same answer is another one."""
    stretched = bar.mesh.vertices @ np.diag([1.3, 0.95, 0.95])
    forces = np.zeros((1, *stretched.shape))
    forces[0, int(bar.mesh.vertices.sum(1).argmax()), 2] = 1.0
    answer = elastic_responses(bar, forces, stretched)[0]
    frequencies, shapes = vibration_modes(bar, 10, positions=stretched)

    def resisted(move: np.ndarray) -> np.ndarray:
        step = 1e-6 / np.abs(move).max()
        difference = bar.gradient(stretched + step * move) - bar.gradient(stretched - step * move)
        return difference / (2 * step)

    force = resisted(answer)
    assert (answer * force).sum() == pytest.approx(1.0, rel=0.01)  # stretched, it resists turns a little too
    others = ~forces[0].any(1)  # the body's inertia alone resists there: that of an affine acceleration
    carried = (bar.mass @ np.column_stack([stretched, np.ones(len(stretched))]))[others]
    motions = [np.outer(column, axis) for column in carried.T for axis in np.eye(3)]
    turns = [resisted(np.cross(axis, stretched))[others] for axis in np.eye(3)]
    allowed = np.stack(motions + turns).reshape(15, -1).T
    fitted = allowed @ np.linalg.lstsq(allowed, force[others].ravel(), rcond=None)[0]
    np.testing.assert_allclose(fitted, force[others].ravel(), atol=1e-4 * np.abs(force).max())
    shape = shapes[-1]
    expected = (2 * np.pi * frequencies[-1]) ** 2 * (bar.mass @ shape)
    np.testing.assert_allclose(resisted(shape), expected, atol=1e-4 * np.abs(expected).max())
    assert np.abs(answer - elastic_responses(bar, forces)[0]).max() > 0.1 * np.abs(answer).max()


def test_frequencies_are_those_of_the_full_model(bar):
    """Twenty weights for ten vibrations; as many eigenmodes miss them by several times as much."""
    truth = vibration_modes(bar, 16)[0][6:]
    errors = []
    for field in (
        elastic_weights(bar, 20, vibrations=10),
        eigenmode_weights(bar, 20),
    ):
        _, stiffness, mass = linear(bar, field)
        squares = scipy.linalg.eigh(stiffness, mass, eigvals_only=True, subset_by_index=(6, 15))
        found = np.sqrt(squares) / (2 * np.pi)
        assert (found > truth * (1 - 1e-6)).all()  # a subspace is never softer
        errors.append(np.abs(found / truth - 1).max())
    assert errors[0] < 0.003 and errors[1] > 5 * errors[0]


def test_body_is_soft_in_every_direction_where_it_is_loaded(bar):
    corner = int(bar.mesh.vertices.sum(1).argmax())
    loads = np.zeros((len(bar.mesh.vertices), 1))
    loads[corner] = 1.0
    columns, stiffness, _ = linear(bar, elastic_weights(bar, 20, loads, vibrations=10))
    plain, plain_stiffness, _ = linear(bar, eigenmode_weights(bar, 20))
    for direction in np.eye(3):
        forces = np.zeros((1, *bar.mesh.vertices.shape))
        forces[0, corner] = direction
        answer = elastic_responses(bar, forces)[0].ravel()
        force = tangent_stiffness(bar) @ answer  # with the inertia that carries it

        def share(basis, matrix, force=force, answer=answer):
            projected = basis.T @ force
            return projected @ np.linalg.lstsq(matrix, projected, rcond=1e-11)[0] / (force @ answer)

        assert share(columns, stiffness) > 0.98
        assert share(plain, plain_stiffness) < 0.9


def test_a_body_is_softer_where_it_is_loaded_more(bar):
    """Ten weights for two corners; only the ratio of the loads counts."""
    corners = [int(bar.mesh.vertices.sum(1).argmax()), int((bar.mesh.vertices @ [1, -1, -1]).argmax())]
    forces = np.zeros((2, 3, *bar.mesh.vertices.shape))
    for corner, force in zip(corners, forces, strict=True):
        force[range(3), corner, range(3)] = 1.0
    answers = [elastic_responses(bar, force).reshape(3, -1).T for force in forces]

    def missed(sizes) -> np.ndarray:
        loads = np.zeros((len(bar.mesh.vertices), 2))
        loads[corners, [0, 1]] = sizes
        columns, _, _ = linear(bar, elastic_weights(bar, 10, loads, vibrations=6))
        return np.array([np.linalg.norm(a - columns @ np.linalg.lstsq(columns, a, rcond=None)[0]) for a in answers])

    first, second = missed([1.0, 0.01]), missed([0.01, 1.0])
    assert first[0] < 0.7 * second[0] and second[1] < 0.7 * first[1]
    np.testing.assert_allclose(missed([30.0, 0.3]), first, rtol=1e-6)


def test_touched_nodes_are_those_that_come_near():
    mesh = box_mesh((0.2, 0.2, 0.2), (2, 2, 2), order=2)
    times = np.array([0.0, 1.0])
    positions = mesh.vertices - mesh.vertices.min(0) + np.array([0.0, 0.0, 0.1]) - times[:, None, None] * [0, 0, 0.099]
    bottom = np.isclose(mesh.vertices[:, 2], mesh.vertices[:, 2].min())
    loads = touched_loads(mesh, positions, times, [Plane()], count=100)
    np.testing.assert_array_equal(loads.sum(1) > 0, bottom & (mesh.node_areas > 0))
    areas = np.sort(mesh.node_areas[loads.any(1)])[::-1]
    np.testing.assert_allclose(loads.sum(0), areas / areas[0])  # all came as near
    assert touched_loads(mesh, positions, times, [Plane()], count=5).shape[1] == 5
    assert touched_loads(mesh, positions, times, [Plane(point=(0, 0, -0.1))]).shape == (len(mesh.vertices), 0)
    rising = Plane(point=(0, 0, -0.1), velocity=(0, 0, 0.1))  # there when the body is
    np.testing.assert_array_equal(touched_loads(mesh, positions, times, [rising], count=100), loads)
    ball = Sphere(center=(0.1, 0.1, -0.05), radius=0.05)
    assert 0 < touched_loads(mesh, positions, times, [ball]).shape[1] < bottom.sum()


def test_what_touches_first_counts_most():
    mesh = box_mesh((0.2, 0.2, 0.2), (2, 2, 2), order=2)

    def on_its_edge(angle):
        turned = mesh.vertices @ Rotation.from_euler("y", angle).as_matrix().T
        return turned - [0, 0, turned[:, 2].min()]

    positions = np.stack([on_its_edge(0.3), on_its_edge(-0.3), on_its_edge(-0.3)])  # twice as long on the other edge
    loads = touched_loads(mesh, positions, np.arange(3.0), [Plane()], count=1)
    np.testing.assert_allclose(positions[0][loads[:, 0] > 0, 2], 0, atol=1e-12)


def test_a_dropped_body_follows_the_full_model():
    """On an edge; with as many weights as eigenmodes it comes several times nearer."""
    mesh = box_mesh((0.2, 0.2, 0.2), (2, 2, 2), order=2)
    turned = np.array([0.15, 0.05, 1.0]) / np.linalg.norm([0.15, 0.05, 1.0])
    floor = Plane(point=(mesh.vertices @ turned).min() * turned - 0.01 * turned, normal=turned)
    full = ElasticBody(mesh, youngs_modulus=5e4, poisson_ratio=0.4)
    timing = Timing(frames=9, fps=48.0, steps_per_frame=4)
    truth = simulate(Scene(full, obstacles=(floor,)), timing).positions
    samples = BodySamples.of_mesh(mesh)

    def scene(field) -> ReducedScene:
        body = ReducedBody(ReducedSpace(field, samples), youngs_modulus=5e4, poisson_ratio=0.4)
        return ReducedScene(body, obstacles=(floor,), contact_stiffness=50 * 5e4 / mesh.size)

    rough = scene(eigenmode_weights(full, 20))
    near = with_elastic_weights(rough, mesh, 20, timing, loaded=12)
    runs = [simulate(one, timing) for one in (rough, near)]
    distances = [float(np.abs(run.positions(mesh.vertices) - truth).max()) for run in runs]
    assert distances[1] < 0.3 * distances[0]
    assert near.body.space.field.count == 20 and near.obstacles == rough.obstacles
    positions = runs[0].positions(mesh.vertices)  # a single pass: about the most deformed frame, and half-way to it
    energies = np.array([full.energy(x) for x in positions])
    most = int(energies.argmax())
    half = int(np.flatnonzero(energies[:most] <= energies[most] / 2)[-1]) + 1
    loads = touched_loads(mesh, positions, runs[0].times, [floor], count=12)
    expected = elastic_weights(full, 20, loads, states=positions[sorted({half, most})])
    found = with_elastic_weights(rough, mesh, 20, timing, loaded=12, passes=1).body.space.field
    np.testing.assert_allclose(np.abs(found.nodal_values), np.abs(expected.nodal_values), atol=1e-6)


def test_a_clamped_body_vibrates_as_it_is_held():
    """A bar that sags: as many weights from the free bar lie many times farther from the full model."""
    mesh = box_mesh((0.3, 0.1, 0.1), (6, 2, 2), order=2)
    full = ElasticBody(mesh, youngs_modulus=5e4, poisson_ratio=0.4)
    clamped = np.isclose(mesh.vertices[:, 0], mesh.vertices[:, 0].min())
    timing = Timing(frames=9, fps=24.0, steps_per_frame=4)
    truth = simulate(Scene(full, node_pins=NodePins(np.flatnonzero(clamped))), timing).positions
    samples = BodySamples.of_mesh(mesh)
    pins = Pins(mesh.vertices[clamped], np.maximum(mesh.node_areas[clamped], 1e-9))

    def scene(field) -> ReducedScene:
        space = ReducedSpace(field, samples, interpolated=True)
        return ReducedScene(ReducedBody(space, youngs_modulus=5e4, poisson_ratio=0.4), pins=pins)

    def distance(field) -> float:
        return float(np.abs(simulate(scene(field), timing).positions(mesh.vertices) - truth).max())

    at_rest = distance(elastic_weights(full, 8, clamped=clamped))
    for free in (elastic_weights(full, 8, even_loads(mesh, 20)), eigenmode_weights(full, 8)):
        assert at_rest < 0.25 * distance(free)
    rough = scene(eigenmode_weights(full, 10))
    found = with_elastic_weights(rough, mesh, 8, timing)
    assert distance(found.body.space.field) < at_rest
    floor = Plane(point=(0, 0, mesh.vertices[:, 2].min()))  # it carries the clamp too, where nothing gives way
    lying = with_elastic_weights(dataclasses.replace(rough, obstacles=(floor,)), mesh, 8, timing)
    assert lying.body.space.field.count == 8


def test_a_clamped_bar_pulled_at_its_end_stretches_evenly():
    """E A u' = F, and ½ J: u' = 1/√(E A L). Held along a line it turns about it, and does not otherwise."""
    mesh = box_mesh((1.0, 0.1, 0.1), (4, 1, 1), order=2)
    body = ElasticBody(mesh, youngs_modulus=2e5, poisson_ratio=0.0)
    left = np.isclose(mesh.vertices[:, 0], mesh.vertices[:, 0].min())
    end = np.isclose(mesh.vertices[:, 0], mesh.vertices[:, 0].max())
    faces = mesh.boundary_faces[end[mesh.boundary_faces].all(1)]
    forces = np.zeros((1, len(mesh.vertices), 3))
    np.add.at(forces[0, :, 0], faces[:, 3:].ravel(), 1 / 3)
    answer = elastic_responses(body, forces, clamped=left)[0]
    expected = (mesh.vertices[:, 0] - mesh.vertices[:, 0].min()) / np.sqrt(2e5 * 0.01)
    np.testing.assert_allclose(answer[:, 0], expected, atol=1e-5 * expected.max())
    np.testing.assert_allclose(answer[:, 1:], 0, atol=1e-5 * expected.max())
    hinge = left & np.isclose(mesh.vertices[:, 2], mesh.vertices[:, 2].min())
    turn = rigid_motions(mesh.vertices, hinge)
    assert len(turn) == 1 and len(rigid_motions(mesh.vertices, left)) == 0 and len(rigid_motions(mesh.vertices)) == 6
    np.testing.assert_allclose(turn[0][hinge], 0, atol=1e-12)
    lifted = np.zeros_like(forces)
    lifted[0, end, 2] = 1.0
    moved = elastic_responses(body, lifted, clamped=hinge)[0]
    np.testing.assert_allclose(moved[hinge], 0, atol=1e-12)
    assert abs((turn[0] * (body.mass @ moved)).sum()) < 1e-6 * np.linalg.norm(turn[0]) * np.linalg.norm(
        body.mass @ moved
    )
    with pytest.raises(InputError, match="where it is held"):
        elastic_responses(body, left[None, :, None] * np.ones(3), clamped=left)


def test_pins_hold_the_nodes_next_to_them():
    mesh = box_mesh((0.3, 0.1, 0.1), (4, 2, 2), order=2)
    clamped = np.isclose(mesh.vertices[:, 0], mesh.vertices[:, 0].min())
    np.testing.assert_array_equal(held_nodes(mesh, Pins(mesh.vertices[clamped] + 1e-4, 2e-4)), clamped)


def test_answers_about_a_squashed_state_span_what_those_at_rest_do_not(bar):
    """Turned with the body, they do not depend on how it lies."""
    x = bar.mesh.vertices - bar.mesh.vertices.mean(0)
    squashed = x.copy()
    squashed[:, 2] *= np.where(x[:, 0] > 0, 0.55, 1.0)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    loads = np.zeros((len(x), 1))
    loads[int(x.sum(1).argmax())] = 1.0
    forces = np.einsum("vk,cd->kcvd", loads, np.eye(3)).reshape(-1, *x.shape)
    answers = elastic_responses(bar, forces, squashed).reshape(3, -1).T

    def missed(states) -> float:
        columns, _, _ = linear(bar, elastic_weights(bar, 16, loads, vibrations=6, states=states))
        left = answers - columns @ np.linalg.lstsq(columns, answers, rcond=None)[0]
        return float(np.linalg.norm(left) / np.linalg.norm(answers))

    assert missed(squashed[None]) < 0.5 * missed(None)
    assert missed((squashed @ turn.T + 0.3)[None]) == pytest.approx(missed(squashed[None]), rel=1e-3)


def test_weights_that_span_a_motion_represent_it(bar):
    """Of a bar that is twisted and waved at once; without it, as many weights miss twice as much."""
    x = bar.mesh.vertices - bar.mesh.vertices.mean(0)
    along = x[:, 0] / np.ptp(x[:, 0])

    def frame(t: float) -> np.ndarray:
        angle, wave = 1.5 * t * along, 0.05 * t * np.sin(7.0 * along + 3.0 * t)
        y = np.cos(angle) * x[:, 1] - np.sin(angle) * x[:, 2]
        z = np.sin(angle) * x[:, 1] + np.cos(angle) * x[:, 2]
        return np.column_stack([x[:, 0], y, z + wave])

    motion = np.stack([frame(t) for t in np.linspace(0.0, 1.0, 6)])
    loads = even_loads(bar.mesh, 4)

    def missed(spanned) -> float:
        columns, _, _ = linear(bar, elastic_weights(bar, 8, loads, motion=spanned))
        wanted = np.moveaxis(motion, 0, -1).reshape(-1, len(motion))
        left = wanted - columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0]
        return float(np.linalg.norm(left) / np.linalg.norm(wanted))

    assert missed(motion) < 0.5 * missed(None)
    with pytest.raises(InputError, match="motion"):
        elastic_weights(bar, 4, loads, motion=motion[0])


def test_states_of_infinite_energy_are_left_out(bar):
    """A logarithmic law in a frame that a rough roll-out has turned inside out."""
    body = ElasticBody(bar.mesh, law="neo_hookean_log", youngs_modulus=1e5)
    x = bar.mesh.vertices
    squeezed = [x * [1.0, 1.0, s] for s in (1.0, 0.9, 0.7, -1.0, 0.8)]
    np.testing.assert_array_equal(most_deformed(body, np.stack(squeezed)), [squeezed[2]])


def test_scene_without_contact_loads_the_whole_surface(bar):
    space = ReducedSpace(eigenmode_weights(bar, 4), BodySamples.of_mesh(bar.mesh))
    scene = ReducedScene(ReducedBody(space, youngs_modulus=1e5, poisson_ratio=0.4))
    found = with_elastic_weights(scene, bar.mesh, 6, Timing(frames=2, fps=24.0)).body
    expected = elastic_weights(bar, 6, even_loads(bar.mesh, 20))
    np.testing.assert_allclose(np.abs(found.space.field.nodal_values), np.abs(expected.nodal_values), atol=1e-6)
    np.testing.assert_array_equal(found.poisson_ratio, 0.4)
    with pytest.raises(InputError, match="mesh"):
        with_elastic_weights(scene, box_mesh((1, 1, 1), (1, 1, 1)), 6, Timing(frames=2))
    started = dataclasses.replace(scene, initial_coordinates=space.affine(np.eye(3), np.zeros(3)))
    with pytest.raises(InputError, match="starts from"):
        with_elastic_weights(started, bar.mesh, 6, Timing(frames=2))


def test_errors(bar):
    loads = even_loads(bar.mesh, 2)
    for count in (0, 65):
        with pytest.raises(InputError, match="1 to 64"):
            elastic_weights(bar, count, loads)
    with pytest.raises(InputError, match="spanned by"):
        elastic_weights(bar, 20, vibrations=2)
    with pytest.raises(InputError, match="loads"):
        elastic_weights(bar, 5, loads[1:])
    with pytest.raises(InputError, match="clamped"):
        elastic_weights(bar, 5, loads, clamped=np.ones(len(loads), dtype=bool))
    with pytest.raises(InputError, match="states"):
        elastic_weights(bar, 5, loads, states=bar.mesh.vertices)
    with pytest.raises(InputError, match="positions"):
        elastic_responses(bar, np.ones((1, len(bar.mesh.vertices), 3)), bar.mesh.vertices[1:])
    with pytest.raises(InputError, match="patches"):
        even_loads(bar.mesh, 0)
    with pytest.raises(InputError, match="positions"):
        touched_loads(bar.mesh, bar.mesh.vertices[None], np.arange(2.0), [Plane()])
    with pytest.raises(InputError, match="only moves"):
        elastic_responses(bar, (bar.mass @ np.ones((len(bar.mesh.vertices), 3)))[None])
    with pytest.raises(InputError, match="forces"):
        elastic_responses(bar, np.zeros((len(bar.mesh.vertices), 3)))


def test_a_stiff_half_stays_whole():
    """E of each element enters vibrations and answers."""
    mesh = box_mesh((0.4, 0.1, 0.1), (4, 1, 1), order=2)
    stiff = mesh.vertices[mesh.tets].mean(1)[:, 0] > mesh.vertices[:, 0].mean()
    body = ElasticBody(mesh, youngs_modulus=np.where(stiff, 1e7, 1e5), poisson_ratio=0.3)
    field = elastic_weights(body, 4, even_loads(mesh, 4), vibrations=6)
    inside = np.unique(mesh.tets[stiff])
    homogeneous = np.column_stack([mesh.vertices, np.ones(len(mesh.vertices))])

    def bending(nodes: np.ndarray) -> np.ndarray:
        """What is not affine there."""
        values = field.nodal_values[nodes]
        return np.linalg.norm(values - homogeneous[nodes] @ np.linalg.lstsq(homogeneous[nodes], values, rcond=None)[0])

    assert bending(inside) < 0.1 * bending(np.unique(mesh.tets[~stiff]))
    assert dataclasses.is_dataclass(field) and field.count == 4


def test_loose_parts_move_on_their_own():
    one = box_mesh((0.1, 0.1, 0.1), (1, 1, 1), order=2)
    count = len(one.vertices)
    above = one.vertices + np.array([0.0, 0.0, 0.2])
    two = TetMesh(np.vstack([one.vertices, above]), np.vstack([one.tets, one.tets + count]))
    body = ElasticBody(two, youngs_modulus=1e5)
    corner = np.zeros((2 * count, 1))
    corner[int(one.vertices.sum(1).argmax())] = 1.0
    columns, _, _ = linear(body, elastic_weights(body, 10, corner))
    upper = np.repeat(np.arange(2 * count) >= count, 3) * np.tile([0.0, 0.0, 1.0], 2 * count)
    left = upper - columns @ np.linalg.lstsq(columns, upper, rcond=None)[0]
    assert np.linalg.norm(left) < 1e-6 * np.linalg.norm(upper)
