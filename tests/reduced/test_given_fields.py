"""Weights from functions of arrays, from a field in a frame of its own, and from snapshots."""

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.fem import ElasticBody
from physconvex.mesh import box_mesh
from physconvex.reduced import (
    ArrayWeights,
    BodySamples,
    ReducedSpace,
    StackedWeights,
    eigenmode_weights,
    predicted_weights,
    snapshot_weights,
)

SIZE = (0.3, 0.2, 0.1)


def inner_points(count: int = 20) -> np.ndarray:
    return np.random.default_rng(1).uniform(0.05, 0.95, (count, 3)) * SIZE


class WavyField:
    """Two weights with their gradients, as a predicted field supplies them: float32, in a frame of its own."""

    handles = 2

    def __call__(self, points: np.ndarray) -> np.ndarray:
        x, y, z = np.asarray(points).T
        return np.stack([np.sin(9 * x) * y, z**2], axis=1).astype(np.float32)

    def gradient(self, points: np.ndarray) -> np.ndarray:
        x, y, z = np.asarray(points).T
        zero = np.zeros_like(x)
        first = np.stack([9 * np.cos(9 * x) * y, np.sin(9 * x), zero], axis=1)
        return np.stack([first, np.stack([zero, zero, 2 * z], axis=1)], axis=1).astype(np.float32)


def by_differences(field, points: np.ndarray, step: float) -> np.ndarray:
    shifted = [(field.at(points + s)[0] - field.at(points - s)[0]) / (2 * step) for s in step * np.eye(3)]
    return np.stack(shifted, axis=-1)


def test_gradients_by_differences_of_the_function():
    field = ArrayWeights(lambda p: np.exp(p[:, :1] * p[:, 1:2]), 1, difference=1e-5)
    points = inner_points()
    values, gradients = field.at(points)
    x, y = points[:, 0], points[:, 1]
    np.testing.assert_allclose(gradients[:, 0], np.stack([y, x, 0 * x], 1) * values, atol=1e-9)


def test_a_predicted_field_is_turned_and_shifted_with_its_gradients():
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    origin = np.array([0.15, 0.1, 0.05])
    field = predicted_weights(WavyField(), origin=origin, rotation=turn)
    points = inner_points()
    values, gradients = field.at(points)
    assert values.dtype == np.float64 and field.count == 2
    # a point of the frame, carried into the body, has the weights of the frame
    inside = np.random.default_rng(2).uniform(-0.05, 0.05, (5, 3))
    np.testing.assert_allclose(field.at(inside @ turn.T + origin)[0], WavyField()(inside), atol=1e-7)
    # float32 values: rounding 6e-8 over the step
    np.testing.assert_allclose(gradients, by_differences(field, points, 1e-3), atol=1e-3)
    larger = predicted_weights(WavyField(), origin=origin, rotation=turn, scale=2.0)
    found = larger.at(2 * (points - origin) + origin)
    np.testing.assert_allclose(found[0], values, atol=1e-7)
    np.testing.assert_allclose(found[1], gradients / 2, atol=1e-6)
    with pytest.raises(InputError, match="scale: got 0"):
        predicted_weights(WavyField(), scale=0.0)


def test_the_field_of_the_network_moves_a_body():
    """Float32 values and gradients of a skinning head become a space in float64 that holds affine motions."""
    from models.config import SkinningConfig
    from models.skinning import SkinningHead

    head = SkinningHead(4, SkinningConfig(handles=3))
    (network,) = head.fields(torch.ones(1, 4), [0.3])
    field = predicted_weights(network, origin=(0.15, 0.1, 0.05))
    points = inner_points()
    np.testing.assert_allclose(field.at(points)[0], network(points - [0.15, 0.1, 0.05]), atol=1e-7)
    # float32: rounding of the weights over the step, and the step's square
    np.testing.assert_allclose(field.at(points)[1], by_differences(field, points, 1e-3), atol=2e-2)
    space = ReducedSpace(field, BodySamples.of_mesh(box_mesh(SIZE, (2, 1, 1))))
    assert space.dimension == 16 and space.shape_values(points).dtype == np.float64
    np.testing.assert_allclose(space.shape_values(points) @ space.rest, points, atol=1e-12)


def test_stacked_fields_stand_beside_each_other():
    body = ElasticBody(box_mesh(SIZE, (2, 1, 1), order=2))
    parts = (eigenmode_weights(body, 2), predicted_weights(WavyField()))
    field, points = StackedWeights(parts), inner_points()
    assert field.count == 4
    for got, first, second in zip(field.at(points), parts[0].at(points), parts[1].at(points), strict=True):
        np.testing.assert_array_equal(got, np.concatenate([first, second], axis=1))


def test_snapshot_weights_hold_the_motions_they_were_made_of():
    body = ElasticBody(box_mesh(SIZE, (2, 2, 1), order=2))
    x = body.mesh.vertices
    shapes = np.stack([x[:, 0] ** 2, x[:, 1] * x[:, 2]], axis=1)
    rng = np.random.default_rng(3)
    bends = [np.einsum("vk,tki->tvi", shapes, rng.normal(size=(4, 2, 3))) for _ in range(2)]
    affine = x @ rng.normal(size=(3, 3)) + rng.normal(size=3)
    field = snapshot_weights(body, [bends[0] + affine, bends[1]], 2)
    gram = field.nodal_values.T @ (body.mass @ field.nodal_values)
    np.testing.assert_allclose(gram, body.total_mass * np.eye(2), atol=1e-6)
    space = ReducedSpace(field, BodySamples.of_mesh(body.mesh))
    values = space.shape_values(x)
    unseen = np.einsum("vk,ki->vi", shapes, rng.normal(size=(2, 3)))
    coordinates = np.linalg.lstsq(values, unseen, rcond=None)[0]
    np.testing.assert_allclose(values @ coordinates, unseen, atol=1e-10)


def test_snapshots_that_carry_more_come_first_and_dependent_ones_are_refused():
    body = ElasticBody(box_mesh(SIZE, (2, 2, 1), order=2))
    x = body.mesh.vertices
    motion = np.zeros((2, len(x), 3))
    motion[0, :, 0], motion[1, :, 1] = 5 * x[:, 0] ** 2, 1e-3 * x[:, 1] ** 2
    first = snapshot_weights(body, [motion], 1).nodal_values[:, 0]
    assert abs(np.corrcoef(first, (x[:, 0] - 0.15) ** 2)[0, 1]) > 0.999
    with pytest.raises(InputError, match="2 independent"):
        snapshot_weights(body, [motion], 3)
    with pytest.raises(InputError, match="0 independent"):
        snapshot_weights(body, [np.stack([2 * x, x])], 1)


@pytest.mark.wrong_types
def test_wrong_input_is_named():
    with pytest.raises(InputError, match="gradient, difference"):
        ArrayWeights(lambda p: p, 3)
    with pytest.raises(InputError, match="function"):
        ArrayWeights(lambda p: p, 2, difference=1e-5).at(inner_points())
    with pytest.raises(InputError, match="rotation"):
        predicted_weights(WavyField(), rotation=np.ones((3, 3)))
    with pytest.raises(InputError, match="fields"):
        StackedWeights(())
    with pytest.raises(InputError, match="displacements"):
        snapshot_weights(ElasticBody(box_mesh(SIZE, (1, 1, 1))), [np.zeros((2, 3, 3))], 1)
