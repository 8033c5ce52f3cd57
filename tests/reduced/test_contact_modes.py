"""Weights that answer to loads on patches of the surface."""

import numpy as np
import pytest

from physconvex.errors import InputError
from physconvex.fem import ElasticBody, box_mesh, skinning_responses, tangent_stiffness
from physconvex.reduced import (
    BodySamples,
    CallableWeights,
    ReducedBody,
    ReducedSpace,
    contact_weights,
    eigenmode_weights,
)
from physconvex.reduced.loads import surface_patches


def test_patches_cover_the_surface_evenly():
    mesh = box_mesh((1.0, 1.0, 1.0), (4, 4, 4), order=1)
    points = mesh.vertices[mesh.node_areas > 0]
    owner = surface_patches(points, 20)
    assert np.bincount(owner, minlength=20).min() >= 2
    spread = [np.linalg.norm(points[owner == k] - points[owner == k].mean(0), axis=1).max() for k in range(20)]
    assert max(spread) < 0.5


def test_response_solves_the_scalar_problem_with_inertia_relief():
    """A bar pulled at one end, carried by its inertia: E A w'' = ρ A a, so that w is a parabola along it."""
    mesh = box_mesh((1.0, 0.1, 0.1), (6, 1, 1), order=2)
    body = ElasticBody(mesh, youngs_modulus=2e5)
    end = np.isclose(mesh.vertices[:, 0], 1.0)
    faces = mesh.boundary_faces[end[mesh.boundary_faces].all(1)]
    traction = np.zeros(len(mesh.vertices))
    np.add.at(traction, faces[:, 3:].ravel(), 1 / 3)  # what an even traction does to a quadratic face
    answer = skinning_responses(body, traction[:, None])[:, 0]
    parabola = mesh.vertices[:, 0] ** 2 - 1 / 3
    np.testing.assert_allclose(answer, parabola / np.sqrt(4 / 45), atol=1e-5)


def compliance(stiffness: np.ndarray, load: np.ndarray) -> float:
    return float(load @ np.linalg.lstsq(stiffness, load, rcond=1e-11)[0])


def test_patches_make_a_body_soft_where_it_is_touched():
    mesh = box_mesh((0.2, 0.2, 0.2), (3, 3, 3), order=2)
    full = ElasticBody(mesh, youngs_modulus=1e5, poisson_ratio=0.3)
    centre = mesh.vertices.mean(0)
    corners = [int(np.linalg.norm(mesh.vertices - centre - s * np.full(3, 0.1), axis=1).argmin()) for s in (-1, 1)]
    load = np.zeros((len(mesh.vertices), 3))
    load[corners[0]], load[corners[1]] = np.full(3, -1.0), np.full(3, 1.0)  # pulled along the diagonal
    truth = compliance(tangent_stiffness(full).toarray(), load.ravel())
    found = []
    for field in (eigenmode_weights(full, 20), contact_weights(full, 10, eigenmodes=10)):
        space = ReducedSpace(field, BodySamples.of_mesh(mesh), interpolated=True)
        body = ReducedBody(space, youngs_modulus=1e5, poisson_ratio=0.3)
        found.append(compliance(body.hessian(body.rest), (space.shape_values(mesh.vertices).T @ load).ravel()) / truth)
    assert found[0] < 0.7 < found[1] < 1


def test_interpolated_products_lie_in_the_space_of_the_full_model():
    mesh = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=2)
    full = ElasticBody(mesh, youngs_modulus=1e5, poisson_ratio=0.3)
    samples, field = BodySamples.of_mesh(mesh), contact_weights(full, 4, eigenmodes=2)
    body = ReducedBody(ReducedSpace(field, samples, interpolated=True), youngs_modulus=1e5, poisson_ratio=0.3)
    y = body.rest + 3e-3 * np.random.default_rng(0).normal(size=body.rest.shape)
    nodes = body.space.shape_values(mesh.vertices) @ y
    assert body.energy(y) == pytest.approx(float(full.energy(nodes)), rel=1e-10)
    product = ReducedBody(ReducedSpace(field, samples), youngs_modulus=1e5, poisson_ratio=0.3)
    assert product.space.dimension == body.space.dimension
    with pytest.raises(InputError, match="CallableWeights"):
        ReducedSpace(CallableWeights(lambda x: x[:, :1], 1), samples, interpolated=True)


def test_too_many_patches_are_refused():
    body = ElasticBody(box_mesh((1.0, 1.0, 1.0), (1, 1, 1), order=1))
    with pytest.raises(InputError, match="at most 8 patches"):
        contact_weights(body, 9, eigenmodes=2)
