"""Convexes carried by deformations: rigid ones look like a moved camera, bodies carry what is bound to them."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.convex import advect, affine_map, bind_to_space, bind_to_tets, half_spaces
from physconvex.fem import ElasticBody
from physconvex.mesh import box_mesh
from physconvex.reduced import BodySamples, ReducedSpace, eigenmode_weights
from physconvex.render import View, render
from tests.convex.fields import random_field
from tests.convex.hulls import support
from tests.convex.scenes import camera

TURN = torch.linalg.matrix_exp(
    torch.tensor([[0.0, -0.4, 0.3], [0.4, 0.0, -0.7], [-0.3, 0.7, 0.0]], dtype=torch.float64)
)
SHIFT = torch.tensor([0.3, -0.2, 0.5], dtype=torch.float64)


def test_a_rigidly_moved_field_looks_to_a_moved_camera_as_before():
    field, view = random_field(6, seed=4), View.of(camera(), torch.float64)
    moved = replace(view, rotation=TURN @ view.rotation, position=TURN @ view.position + SHIFT)
    before = render(field, view, backend="reference")
    after = render(advect(field, affine_map(TURN, SHIFT)), moved, backend="reference")
    assert before.alpha.max() > 0.5
    torch.testing.assert_close(after.colour, before.colour, rtol=0, atol=1e-9)
    torch.testing.assert_close(after.depth, before.depth)


def test_an_affine_map_changes_the_support_function_as_it_must():
    field = random_field(3, seed=5)
    linear = torch.eye(3, dtype=torch.float64) + 0.3 * random_field(1, points=4, seed=6).points[0, :3]
    directions = torch.randn(10, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    moved = advect(field, affine_map(linear, SHIFT))
    expected = support(field, directions @ linear) + (directions @ SHIFT)[:, None]
    torch.testing.assert_close(support(moved, directions), expected)


@pytest.mark.parametrize("order", [1, 2])
def test_a_field_bound_to_tetrahedra_follows_an_affine_motion_exactly(order):
    field = random_field(4, seed=7, size=0.02, spread=0.03)
    field = field.with_points(field.points + field.points.new_tensor([0.15, 0.1, 0.05]))
    mesh = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=order)
    linear = TURN.numpy() @ np.diag([1.2, 0.9, 1.1])
    moved = bind_to_tets(field, mesh).at(mesh.vertices @ linear.T + SHIFT.numpy())
    expected = advect(field, affine_map(torch.as_tensor(linear), SHIFT))
    torch.testing.assert_close(moved.points, expected.points)
    torch.testing.assert_close(moved.harmonics, expected.harmonics)


def test_the_gradient_of_a_bent_quadratic_mesh_is_that_of_the_map():
    mesh = box_mesh((0.3, 0.2, 0.1), (3, 2, 1), order=2)
    field = random_field(4, seed=8, size=0.01, spread=0.02)
    field = field.with_points(field.points + field.points.new_tensor([0.15, 0.1, 0.05]))

    def bend(points: np.ndarray) -> np.ndarray:
        return points + np.stack([0 * points[:, 0], 0 * points[:, 0], 2 * points[:, 0] ** 2], axis=1)

    bound = bind_to_tets(field, mesh)
    moved = bound.at(bend(mesh.vertices))
    np.testing.assert_allclose(moved.points.reshape(-1, 3), bend(field.points.reshape(-1, 3).numpy()), atol=1e-12)
    gradients = np.asarray(bound.gradients @ bend(mesh.vertices)).reshape(-1, 3, 3).swapaxes(1, 2)
    np.testing.assert_allclose(gradients[:, 2, 0], 4 * field.centres[:, 0], atol=1e-10)
    np.testing.assert_allclose(gradients[:, 0], [[1.0, 0.0, 0.0]] * 4, atol=1e-10)


def test_a_field_bound_to_a_reduced_body_moves_as_its_points_do():
    mesh = box_mesh((0.3, 0.2, 0.1), (2, 1, 1), order=2)
    space = ReducedSpace(eigenmode_weights(ElasticBody(mesh), 3), BodySamples.of_mesh(mesh))
    field = random_field(4, seed=9, size=0.02, spread=0.03)
    field = field.with_points(field.points + field.points.new_tensor([0.15, 0.1, 0.05]))
    bound = bind_to_space(field, space)
    turned = bound.at(space.affine(TURN.numpy(), SHIFT.numpy()))
    expected = advect(field, affine_map(TURN, SHIFT))
    torch.testing.assert_close(turned.points, expected.points)
    torch.testing.assert_close(turned.harmonics, expected.harmonics)
    bent = space.rest + 0.01 * np.random.default_rng(0).normal(size=space.rest.shape)
    points = field.points.reshape(-1, 3).numpy()
    np.testing.assert_allclose(bound.at(bent).points.reshape(-1, 3), space.shape_values(points) @ bent)
    with pytest.raises(InputError, match="coordinates"):
        bound.at(bent[1:])


def test_edges_keep_their_width_in_a_stretched_field():
    field = random_field(2, seed=1)
    stretched = advect(field, affine_map(2 * torch.eye(3, dtype=torch.float64), SHIFT))
    assert torch.equal(stretched.smoothness, field.smoothness)
    volume = [half_spaces(one).offsets.shape[1] for one in (field, stretched)]
    assert volume[0] == volume[1] and not math.isnan(float(stretched.points.sum()))
