"""Contact at points of a surface that the mesh carries."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from physconvex import InputError
from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody, NodalEquations, NodePins, Scene, SurfacePoints
from physconvex.mesh import Embedding, TetMesh, box_mesh, to_quadratic


@pytest.fixture(scope="module")
def shown():
    """A box of 0.24 × 0.2 × 0.14 m, as triangles."""
    box = trimesh.creation.box((0.24, 0.2, 0.14)).subdivide().subdivide()
    return np.asarray(box.vertices), np.asarray(box.faces)


@pytest.fixture(scope="module")
def inner():
    """Tetrahedra that lie 10 mm within it."""
    mesh = box_mesh((0.22, 0.18, 0.12), (2, 2, 1), order=1)
    return to_quadratic(TetMesh(mesh.vertices - [0.11, 0.09, 0.06], mesh.tets))


def scene_of(mesh, points, **changes):
    body = ElasticBody(mesh, youngs_modulus=5e4, poisson_ratio=0.3, density=1000.0)
    return Scene(body, obstacles=(Plane(point=(0, 0, -0.0705), friction=0.5),), contact_points=points, **changes)


def test_points_stand_for_the_whole_area_and_keep_the_corners(shown):
    vertices, faces = shown
    few = SurfacePoints.of_triangles(vertices, faces, count=40)
    assert len(few.points) < len(vertices)
    assert few.areas.sum() == pytest.approx(2 * (0.24 * 0.2 + 0.24 * 0.14 + 0.2 * 0.14))
    corners = np.abs(few.points) == [0.12, 0.1, 0.07]
    assert corners.all(1).sum() == 8
    with pytest.raises(InputError, match="at least one"):
        SurfacePoints(np.zeros((0, 3)), np.zeros(0))


def test_forces_are_the_derivative_of_the_energy_and_stiffness_that_of_the_forces(shown, inner):
    top = np.flatnonzero(inner.vertices[:, 2] > 0.059)
    scene = scene_of(inner, SurfacePoints.of_triangles(*shown), node_pins=NodePins(top))
    equations, rng = NodalEquations(scene), np.random.default_rng(0)
    x = inner.vertices * 1.02 - [0, 0, 0.004]
    direction, step = rng.normal(size=x.shape), 1e-7
    direction[top] = 0.0
    ahead, behind = (equations.evaluate(x + sign * step * direction) for sign in (1, -1))
    gradient = equations.evaluate(x)[1]
    assert (ahead[0] - behind[0]) / (2 * step) == pytest.approx((gradient * direction).sum(), rel=1e-5)
    equations.factorise(x, project=False)
    change = (ahead[1] - behind[1]) / (2 * step)
    np.testing.assert_allclose(equations.solve(change), direction, atol=1e-4)


def test_a_body_lands_on_the_surface_that_is_shown_and_not_on_its_mesh(shown, inner):
    points = SurfacePoints.of_triangles(*shown)
    lowest = {}
    for name, where in (("surface", points), ("nodes", None)):
        run = simulate(
            scene_of(inner, where, damping_time=5e-3, air_drag=4.0), Timing(frames=12, fps=24.0, steps_per_frame=8)
        )
        moved = Embedding.of_points(inner, shown[0]).apply(run.positions[-1])
        lowest[name] = moved[:, 2].min() + 0.0705
    assert abs(lowest["surface"]) < 1e-3
    assert lowest["nodes"] == pytest.approx(-0.01, abs=1.5e-3)


def test_a_surface_of_few_triangles_is_cut_into_many_points():
    box = trimesh.creation.box((0.3, 0.2, 0.1))
    points = SurfacePoints.of_triangles(box.vertices, box.faces, count=1500)
    assert 750 <= len(points.areas) <= 3000
    assert np.isclose(points.areas.sum(), box.area)
    on_top = points.points[:, 2] > 0.0499
    assert cKDTree(points.points[on_top][:, :2]).query([[0.013, 0.021]])[0] < 0.02
