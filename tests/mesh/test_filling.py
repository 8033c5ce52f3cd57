"""Elements that are filled as far as a surface does."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from physconvex import InputError
from physconvex.dynamics import Timing, simulate
from physconvex.fem import ElasticBody, Scene, vibration_modes
from physconvex.mesh import TetMesh, box_mesh, filled, filling, tetrahedralize, to_quadratic, unit_mass
from physconvex.reduced import BodySamples, ReducedBody, ReducedSpace, eigenmode_weights

SIZE = (0.3, 0.2, 0.2)


def moments(body):
    """Mass, centre of mass and inertia about it, by the mass matrix."""
    x, mass = body.mesh.vertices, body.mass
    total = body.node_masses.sum()
    centre = body.node_masses @ x / total
    return total, centre, (x - centre).T @ (mass @ (x - centre))


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture(scope="module")
def box():
    return box_mesh(SIZE, (3, 2, 2))


@pytest.fixture(scope="module")
def smaller(box):
    """The surface of a box that ends within the elements of `box` at two sides, and beyond them at one."""
    low, high = np.array([0.01, -0.01, 0.03]), np.array([0.27, 0.2, 0.2])
    inner = box_mesh(tuple(high - low), (1, 1, 1), order=1)
    vertices, triangles = inner.surface
    return low, high, (vertices + low, triangles)


def test_elements_that_are_full_are_as_they_were(box, rng):
    part = filled(box, *box.surface)
    plain, same = ElasticBody(box), ElasticBody(part)
    np.testing.assert_allclose(part.filling.weights, plain._weights.numpy(), rtol=0.05)
    np.testing.assert_allclose(part.filling.barycentric, plain._barycentric, atol=0.05)  # 270 points in each
    assert same.total_mass == pytest.approx(plain.total_mass, rel=1e-12)
    x = box.vertices + 0.01 * rng.normal(size=box.vertices.shape)
    assert same.energy(x) == pytest.approx(plain.energy(x), rel=0.01)
    np.testing.assert_allclose(vibration_modes(same, 12)[0][6:], vibration_modes(plain, 12)[0][6:], rtol=2e-3)


@pytest.mark.parametrize("order", [1, 2])
def test_mass_and_inertia_are_those_of_the_surface(box, smaller, order):
    low, high, surface = smaller
    mesh = box if order == 2 else box_mesh(SIZE, (3, 2, 2), order=1)
    total, centre, inertia = moments(ElasticBody(filled(mesh, *surface)))
    size = high - low
    assert total == pytest.approx(1000 * size.prod(), rel=5e-3)  # but for elements that count as a twentieth full
    np.testing.assert_allclose(centre, (low + high) / 2, atol=1e-3)
    np.testing.assert_allclose(np.diag(inertia), total * size**2 / 12, rtol=0.02)
    assert abs(moments(ElasticBody(mesh))[0] / total - 1) > 0.1  # without


def test_energy_of_an_affine_motion_is_that_of_the_surface(box, smaller, rng):
    """Wherever the quadrature points lie: the deformation gradient is the same everywhere."""
    low, high, surface = smaller
    body = ElasticBody(filled(box, *surface), youngs_modulus=1e5, poisson_ratio=0.3)
    f = np.eye(3) + 0.2 * rng.normal(size=(3, 3))
    f *= np.sign(np.linalg.det(f))
    whole = ElasticBody(box, youngs_modulus=1e5, poisson_ratio=0.3)
    density = whole.energy(box.vertices @ f.T) / box.volume
    assert body.energy(box.vertices @ f.T) == pytest.approx(density * (high - low).prod(), rel=5e-3)


def test_second_moments_of_what_fills_an_element_are_kept(box, smaller):
    """The rule is of degree 2 for the part of each element that is filled."""
    filling = filled(box, *smaller[2]).filling
    count = np.bincount(filling.cells, minlength=len(box.tets))
    for element in np.flatnonzero(count > 30)[::5]:
        inner = filling.points[filling.cells == element]
        inside = ((inner >= 0) & (inner <= SIZE)).all(axis=1)
        if not inside.all():
            continue  # points beyond the mesh count at its surface
        rule = filling.barycentric[element] @ box.vertices[box.corner_tets[element]]
        np.testing.assert_allclose(rule.mean(axis=0), inner.mean(axis=0), atol=1e-12)
        np.testing.assert_allclose(np.cov(rule.T, bias=True), np.cov(inner.T, bias=True), atol=1e-12)


def test_elements_with_few_points_resist_all_that_deforms_them(monkeypatch):
    """Small ones among large ones hold a point or two, whose rule alone leaves motions without energy or mass."""
    box = box_mesh(SIZE, (8, 2, 2), order=1)
    place = box.vertices * np.array([1 / SIZE[0], 1.0, 1.0])
    place[:, 0] = SIZE[0] * np.square(place[:, 0])  # cells that grow from a 64th of the length to a quarter
    mesh = to_quadratic(replace(box, vertices=place))
    for name, value in {"_POINTS": 500, "_PER_ELEMENT": 1, "_BLOCK": 500}.items():
        monkeypatch.setattr(filling, name, value)
    filling._inside.cache_clear()
    part = filled(mesh, *mesh.surface)
    counts = np.bincount(part.filling.cells, minlength=len(mesh.tets))
    assert {1, 2, 3} <= set(counts)
    least, usual = (
        np.linalg.eigvalsh(ElasticBody(grid).element_hessians(mesh.vertices))[:, 6] for grid in (part, mesh)
    )  # beside the six motions of a rigid body
    assert (least > 0.049 * usual).all()  # an empty one has a twentieth
    weight, least = part.filling.weights.sum(axis=1), np.linalg.eigvalsh(unit_mass(2))[0]
    assert (np.linalg.eigvalsh(part.filling.mass)[counts < 10, 0] > 0.1 * least * weight[counts < 10]).all()
    np.testing.assert_allclose(part.filling.mass.sum(axis=(1, 2)), weight, rtol=1e-9)


def test_empty_elements_count_as_a_twentieth(box):
    """A small surface in one corner: the elements far off are there, and hardly weigh."""
    corner = trimesh.creation.box((0.1, 0.1, 0.1), transform=trimesh.transformations.translation_matrix([0.05] * 3))
    part = filled(box, np.asarray(corner.vertices), np.asarray(corner.faces))
    shares = part.filling.weights.sum(axis=1) / box.element_volumes
    assert shares.min() == pytest.approx(0.05)
    assert shares.max() == pytest.approx(1.0, abs=0.15)
    np.testing.assert_allclose(part.filling.mass.sum(axis=(1, 2)), part.filling.weights.sum(axis=1), rtol=1e-9)
    assert np.isfinite(vibration_modes(ElasticBody(part), 10)[0]).all()


def test_gradient_is_that_of_the_energy(box, smaller, rng):
    body = ElasticBody(filled(box, *smaller[2]))
    x = box.vertices + 0.01 * rng.normal(size=box.vertices.shape)
    step = rng.normal(size=x.shape)
    slope = (body.energy(x + 1e-6 * step) - body.energy(x - 1e-6 * step)) / 2e-6
    assert (body.gradient(x) * step).sum() == pytest.approx(slope, rel=1e-6)
    stiffness = body.element_hessians(x)
    change = (body.gradient(x + 1e-6 * step) - body.gradient(x - 1e-6 * step)) / 2e-6
    found = np.zeros_like(x)
    local = np.einsum("eij,ej->ei", stiffness, step[box.tets].reshape(len(box.tets), -1))
    np.add.at(found, box.tets, local.reshape(*box.tets.shape, 3))
    np.testing.assert_allclose(found, change, atol=1e-6 * np.abs(change).max())


def test_few_elements_vibrate_like_a_sphere():
    """What a coarse mesh's corners do to a sphere: its five lowest modes have one frequency."""
    sphere = trimesh.creation.icosphere(4, 0.1)
    surface = np.asarray(sphere.vertices), np.asarray(sphere.faces)
    mesh = tetrahedralize(surface, max_nodes=150, order=2, method="lattice")

    def spread(body):
        lowest = vibration_modes(ElasticBody(body), 11)[0][6:]
        return np.ptp(lowest) / lowest.mean(), lowest.mean()

    (before, _), (after, mean) = spread(mesh), spread(filled(mesh, *surface))
    assert after < 0.3 * before
    shear, density = 1e5 / 2.8, 1000.0  # torsion of degree 2 (Lamb 1882): k a = 2.501 for any ν
    assert mean == pytest.approx(2.501 / 0.1 * np.sqrt(shear / density) / (2 * np.pi), rel=0.03)


def test_a_body_falls_as_all_bodies_do(box, smaller):
    part, whole = (
        simulate(Scene(ElasticBody(m), initial_velocity=(1.0, 0, 0)), Timing(frames=5, fps=50.0, steps_per_frame=2))
        for m in (filled(box, *smaller[2]), box)
    )
    np.testing.assert_allclose(part.positions, whole.positions, atol=1e-9)


def test_the_reduced_body_has_the_same_mass_and_energy(box, smaller, rng):
    part = filled(box, *smaller[2])
    samples = BodySamples.of_mesh(part)
    full = ElasticBody(part)
    assert samples.mass.volume == pytest.approx(full.total_mass / 1000, rel=5e-3)
    assert samples.interior.volume == pytest.approx(full.total_mass / 1000, rel=1e-9)
    space = ReducedSpace(eigenmode_weights(full, 3), samples)
    body = ReducedBody(space)
    q = space.rest + 0.02 * rng.normal(size=space.rest.shape)
    x = space.shape_values(box.vertices) @ q
    assert body.energy(q) == pytest.approx(full.energy(x), rel=0.02)


def test_open_surfaces_fill_nothing(box, smaller):
    vertices, triangles = smaller[2]
    assert filled(box, vertices, triangles[1:]) is box


def test_a_filling_of_another_mesh_is_refused(box, smaller):
    part = filled(box, *smaller[2])
    other = box_mesh(SIZE, (2, 2, 2))
    with pytest.raises(InputError, match="filling: got one of 72 elements of 10 nodes; expected 48 of 10"):
        replace(other, filling=part.filling)
    with pytest.raises(InputError, match="expected 72 of 4"):
        TetMesh(*(lambda m: (m.vertices, m.tets))(box_mesh(SIZE, (3, 2, 2), order=1)), filling=part.filling)
    assert to_quadratic(part) is part
