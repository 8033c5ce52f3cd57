"""Skinning weights: values and exact gradients, from meshes and from functions."""

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.fem import ElasticBody
from physconvex.mesh import box_mesh
from physconvex.reduced import CallableWeights, NodalWeights, eigenmode_weights, sample_basis, tet_cubature

SIZE = (0.3, 0.2, 0.1)


def inner_points(count: int = 40) -> np.ndarray:
    return np.random.default_rng(1).uniform(0.02, 0.98, (count, 3)) * SIZE


def by_differences(field, points: np.ndarray, step: float = 1e-7) -> np.ndarray:
    shifted = [(field.at(points + step * e)[0] - field.at(points - step * e)[0]) / (2 * step) for e in np.eye(3)]
    return np.stack(shifted, axis=-1)


@pytest.mark.parametrize("order", [1, 2])
def test_nodal_weights_reproduce_polynomials_of_their_order(order):
    mesh = box_mesh(SIZE, (2, 2, 1), order=order)

    def polynomial(x):
        return 2 * x[:, 0] - x[:, 1] + (0 if order == 1 else 3 * x[:, 0] * x[:, 2] - x[:, 1] ** 2)

    field = NodalWeights(mesh, polynomial(mesh.vertices)[:, None])
    points = inner_points()
    values, gradients = field.at(points)
    np.testing.assert_allclose(values[:, 0], polynomial(points), atol=1e-13)
    x, y, z = points.T
    quadratic = (order == 2) * np.stack([3 * z, -2 * y, 3 * x], axis=1)
    np.testing.assert_allclose(gradients[:, 0], np.array([2, -1, 0]) + quadratic, atol=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_gradient_of_eigenmodes_is_that_of_the_interpolation(order):
    body = ElasticBody(box_mesh(SIZE, (2, 2, 1), order=order))
    field = eigenmode_weights(body, 5)
    # inside elements: across faces the gradient jumps
    points = tet_cubature(body.mesh).points
    np.testing.assert_allclose(field.at(points)[1], by_differences(field, points), rtol=1e-6, atol=1e-6)


def test_points_outside_the_mesh_continue_linearly():
    mesh = box_mesh((1.0, 1.0, 1.0), (1, 1, 1))
    field = NodalWeights(mesh, (mesh.vertices[:, :1]) ** 2)
    values, gradients = field.at(np.array([[1.25, 0.4, 0.3]]))
    assert values[0, 0] == pytest.approx(1.5) and gradients[0, 0] == pytest.approx([2, 0, 0])


def test_callable_weights_and_the_constant_weight():
    field = CallableWeights(lambda x: torch.stack([torch.sin(7 * x[:, 0]) * x[:, 1], torch.exp(x[:, 2])], 1), 2)
    points = inner_points()
    basis = sample_basis(field, points)
    np.testing.assert_array_equal(basis.values[:, 0], 1.0)
    np.testing.assert_array_equal(basis.gradients[:, 0], 0.0)
    np.testing.assert_allclose(basis.gradients[:, 1:], by_differences(field, points), rtol=1e-6, atol=1e-7)


def test_callable_that_depends_on_nothing_has_no_gradient():
    _, gradients = CallableWeights(lambda x: torch.ones(len(x), 1, dtype=x.dtype), 1).at(inner_points(3))
    np.testing.assert_array_equal(gradients, 0.0)


def test_no_points_have_no_weights():
    mesh = box_mesh(SIZE, (1, 1, 1))
    values, gradients = NodalWeights(mesh, mesh.vertices).at(np.zeros((0, 3)))
    assert values.shape == (0, 3) and gradients.shape == (0, 3, 3)


@pytest.mark.parametrize("count", [0, 65])
def test_number_of_weights_is_checked(count):
    with pytest.raises(InputError, match="count"):
        eigenmode_weights(ElasticBody(box_mesh(SIZE, (2, 1, 1))), count)


@pytest.mark.wrong_types
def test_wrong_shapes_are_named():
    mesh = box_mesh(SIZE, (1, 1, 1))
    with pytest.raises(InputError, match="nodal_values"):
        NodalWeights(mesh, np.zeros((3, 2)))
    with pytest.raises(InputError, match="function"):
        CallableWeights(lambda x: x, 2).at(inner_points(4))
    with pytest.raises(InputError, match="points"):
        sample_basis(CallableWeights(lambda x: x, 3), np.zeros((4, 2)))
