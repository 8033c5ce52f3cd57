"""Samples of a body: exact volumes, mass, polynomials."""

import numpy as np
import pytest
import trimesh

from physconvex import InputError
from physconvex.mesh import box_mesh, tetrahedralize
from physconvex.reduced import BodySamples, Cubature, tet_cubature

SIZE = (0.3, 0.2, 0.1)


def box_moment(powers: tuple[int, int, int]) -> float:
    return float(np.prod([length ** (p + 1) / (p + 1) for length, p in zip(SIZE, powers, strict=True)]))


@pytest.mark.parametrize(("degree", "count"), [(1, 1), (2, 4), (3, 8), (4, 27), (6, 64)])
def test_rules_are_exact_up_to_their_degree(degree, count):
    mesh = box_mesh(SIZE, (2, 1, 1))
    cubature = tet_cubature(mesh, degree=degree)
    assert len(cubature.points) == count * len(mesh.tets)
    assert cubature.volume == pytest.approx(0.006, rel=1e-12)
    for powers in np.ndindex(degree + 1, degree + 1, degree + 1):
        if sum(powers) <= degree:
            value = cubature.weights @ np.prod(cubature.points ** np.array(powers), axis=1)
            assert value == pytest.approx(box_moment(powers), rel=1e-9)


def test_degree_beyond_the_rule_is_not_exact():
    cubature = tet_cubature(box_mesh(SIZE, (1, 1, 1)), degree=2)
    assert cubature.weights @ cubature.points[:, 0] ** 6 != pytest.approx(box_moment((6, 0, 0)), rel=1e-3)


def test_cells_tell_which_tetrahedron_a_point_belongs_to():
    mesh = box_mesh(SIZE, (2, 1, 1))
    cubature = tet_cubature(mesh, degree=3)
    volumes = np.bincount(cubature.cells, cubature.weights)
    np.testing.assert_allclose(volumes, mesh.element_volumes, rtol=1e-12)


def test_a_watertight_surface_keeps_its_volume_within_one_per_cent():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    samples = BodySamples.of_mesh(tetrahedralize(ball, method="lattice", max_nodes=150))
    assert samples.interior.volume == pytest.approx(ball.volume, rel=0.01)
    assert samples.mass.volume == pytest.approx(ball.volume, rel=0.01)
    assert samples.surface_areas.sum() == pytest.approx(ball.area, rel=0.05)
    assert samples.size == pytest.approx(0.2, rel=0.05)


def test_surface_samples_are_the_boundary_nodes():
    samples = BodySamples.of_mesh(box_mesh(SIZE, (2, 2, 2)))
    assert samples.surface_areas.sum() == pytest.approx(0.22) and (samples.surface_areas > 0).all()


def test_points_given_outright():
    points = np.random.default_rng(0).uniform(size=(50, 3))
    samples = BodySamples.of_points(points, 2.0)
    assert samples.interior.volume == pytest.approx(2.0) and len(samples.surface_points) == 0
    with pytest.raises(InputError, match="surface_areas"):
        BodySamples.of_points(points, 2.0, surface_points=points)
    with pytest.raises(InputError, match="weights"):
        Cubature(points, -np.ones(50), np.arange(50), 50)
    with pytest.raises(InputError, match="degree"):
        tet_cubature(box_mesh(SIZE, (1, 1, 1)), degree=0)
