"""The data-free neural field: what it learns, exact gradients, and whether it moves a body better than chance."""

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.dynamics import Plane, Timing, simulate
from physconvex.fem import ElasticBody, Scene
from physconvex.mesh import box_mesh
from physconvex.reduced import (
    BodySamples,
    CallableWeights,
    NeuralFieldOptions,
    NeuralWeights,
    ReducedBody,
    ReducedScene,
    ReducedSpace,
    eigenmode_weights,
    train_neural_weights,
    untrained_neural_weights,
)

SIZE = (0.3, 0.2, 0.1)
SMALL = NeuralFieldOptions(hidden_size=24, steps=500, points=200, transforms=4, learning_rate=1e-2)


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.fixture(scope="module")
def samples() -> BodySamples:
    return BodySamples.of_mesh(box_mesh(SIZE, (3, 2, 1), order=2))


@pytest.fixture(scope="module")
def trained(samples) -> NeuralWeights:
    return train_neural_weights(samples, 2, generator=seeded(), options=SMALL)


def orthonormal(samples: BodySamples, values: np.ndarray) -> np.ndarray:
    """Span of the weights and the constant, orthonormal with respect to volume."""
    root = np.sqrt(samples.interior.weights)[:, None]
    return np.linalg.qr(root * np.hstack([np.ones((len(values), 1)), values]))[0]


def roughness(samples: BodySamples, field) -> float:
    """Sum of ∫ |∇w|² over an orthonormal basis of the span of the weights beside the constant."""
    values, gradients = field.at(samples.interior.points)
    weights = samples.interior.weights
    centred = values - weights @ values / weights.sum()
    gram = np.einsum("q,qm,qn->mn", weights, centred, centred)
    slopes = np.einsum("q,qmi,qni->mn", weights, gradients, gradients)
    return float(np.trace(np.linalg.solve(gram, slopes)))


def test_training_lowers_the_loss_and_the_roughness_of_the_span(samples, trained):
    start = untrained_neural_weights(samples, 2, generator=seeded(), options=SMALL)
    c = SMALL.orthogonality
    loss = trained.elastic_history + c * trained.orthogonality_history
    assert loss[-20:].mean() < 0.2 * loss[:5].mean()
    assert roughness(samples, trained) < 0.8 * roughness(samples, start)
    # no two weights are smoother than the first two eigenmodes of the Laplacian
    modes = eigenmode_weights(ElasticBody(box_mesh(SIZE, (3, 2, 1), order=2)), 2)
    assert roughness(samples, trained) < 1.25 * roughness(samples, modes)


def test_weights_are_nearly_orthonormal_and_span_what_the_first_eigenmodes_span(samples, trained):
    values, _ = trained.at(samples.interior.points)
    together = np.hstack([np.ones((len(values), 1)), values])
    gram = together.T @ (samples.interior.weights[:, None] * together) / samples.interior.volume
    # the elastic term e pulls w² to about 1 − e/2c, a few per cent here; points are drawn at random besides
    np.testing.assert_allclose(gram, np.eye(3), atol=0.15)
    modes = eigenmode_weights(ElasticBody(box_mesh(SIZE, (3, 2, 1), order=2)), 2).at(samples.interior.points)[0]
    cosines = np.linalg.svd(orthonormal(samples, values).T @ orthonormal(samples, modes))[1]
    assert cosines.min() > 0.9


def test_gradients_are_exact_and_double_precision(trained):
    points, step = np.random.default_rng(1).uniform(size=(20, 3)) * SIZE, 1e-6
    values, gradients = trained.at(points)
    assert values.dtype == gradients.dtype == np.float64 and trained.count == 2
    by_differences = [(trained.at(points + s)[0] - trained.at(points - s)[0]) / (2 * step) for s in step * np.eye(3)]
    np.testing.assert_allclose(gradients, np.stack(by_differences, axis=-1), rtol=1e-6, atol=1e-7)


def test_training_is_repeatable_and_leaves_the_global_generator_alone(samples):
    short = NeuralFieldOptions(hidden_size=8, steps=3, points=32)
    before = torch.get_rng_state()
    first, again = (train_neural_weights(samples, 2, generator=seeded(4), options=short) for _ in range(2))
    other = train_neural_weights(samples, 2, generator=seeded(5), options=short)
    points = samples.surface_points[:5]
    np.testing.assert_array_equal(first.at(points)[0], again.at(points)[0])
    assert np.abs(first.at(points)[0] - other.at(points)[0]).max() > 1e-3
    assert torch.equal(before, torch.get_rng_state())


@pytest.mark.slow
def test_a_stiff_half_moves_as_one():
    """Weights vary less where the body is stiff."""
    mesh = box_mesh((0.2, 0.1, 0.1), (4, 2, 2))
    samples = BodySamples.of_mesh(mesh)
    left = mesh.vertices[mesh.tets].mean(1)[:, 0] < 0.1
    modulus = np.where(left, 100.0, 1.0)
    field = train_neural_weights(samples, 2, generator=seeded(), youngs_modulus=modulus, options=SMALL)
    _, gradients = field.at(samples.interior.points)
    steep = (gradients**2).sum((1, 2))
    stiff = samples.interior.points[:, 0] < 0.1
    assert steep[stiff].mean() < 0.2 * steep[~stiff].mean()


def drop_distance(mesh, modulus, fields) -> list[float]:
    """Root mean square distance [m] of a dropped body with each of the fields to the full model."""
    constants = {"youngs_modulus": modulus, "poisson_ratio": 0.35}
    floor = (Plane(point=(0, 0, -0.01), normal=(0.2, 0.1, 1.0)),)
    timing = Timing(frames=7, fps=48, steps_per_frame=6)
    full = simulate(Scene(ElasticBody(mesh, **constants), obstacles=floor, initial_velocity=(0, 0, -1)), timing)
    found = []
    for field in fields:
        body = ReducedBody(ReducedSpace(field, BodySamples.of_mesh(mesh)), **constants)
        scene = ReducedScene(body, obstacles=floor, initial_velocity=(0, 0, -1))
        moved = simulate(scene, timing).positions(mesh.vertices)
        found.append(float(np.sqrt(((moved - full.positions) ** 2).sum(-1).mean())))
    return found


@pytest.mark.slow
def test_a_dropped_cube_comes_nearer_to_the_full_model_than_with_random_waves():
    """Waves of 8 cm and less."""

    def random_waves(seed: int) -> CallableWeights:
        waves = torch.randn(3, 3, dtype=torch.float64, generator=seeded(seed))
        waves = 2 * np.pi / 0.08 * (1 + waves.abs()) * waves.sign()
        return CallableWeights(lambda x: torch.sin(x @ waves), 3)

    mesh = box_mesh((0.2, 0.2, 0.2), (2, 2, 2))
    field = train_neural_weights(BodySamples.of_mesh(mesh), 3, generator=seeded(), options=SMALL)
    learnt, *random = drop_distance(mesh, 2e4, [field, *(random_waves(seed) for seed in range(3))])
    assert learnt < 0.8 * min(random), (learnt, random)


@pytest.mark.wrong_types
def test_bad_options_are_named(samples):
    for name, value in {"steps": -1, "hidden_size": 0, "learning_rate": np.nan, "orthogonality": 0.0}.items():
        with pytest.raises(InputError, match=name):
            NeuralFieldOptions(**{name: value})
    with pytest.raises(InputError, match="count"):
        train_neural_weights(samples, 0, generator=seeded())
    with pytest.raises(InputError, match="youngs_modulus"):
        train_neural_weights(samples, 2, generator=seeded(), youngs_modulus=np.ones(3))
    wild = NeuralFieldOptions(hidden_size=8, steps=20, points=16, learning_rate=1e300)
    with pytest.raises(InputError, match="learning_rate"):
        train_neural_weights(samples, 2, generator=seeded(), options=wild)
