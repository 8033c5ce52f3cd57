"""The score statistic: planted doses come back, nothing is called where nothing is, nuisances earn nothing."""

import numpy as np
import pytest

from physconvex import InputError
from physconvex.gap import ErrorModel, Projector, score_effect

N = 300


@pytest.fixture
def setting():
    rng = np.random.default_rng(0)
    nuisances, signature = rng.normal(size=(3, N)), rng.normal(size=(1, N))
    directions = 5 * rng.normal(size=(2, N))
    variance = rng.uniform(0.5, 3.0, N)
    return Projector(ErrorModel(variance, directions), nuisances), signature


def draw(projector, rng):
    errors = projector.errors
    return np.sqrt(errors.variance) * rng.normal(size=N) + rng.normal(size=len(errors.directions)) @ errors.directions


def test_whitening_gives_unit_covariance(setting):
    projector, _ = setting
    errors = projector.errors
    v = np.diag(errors.variance) + errors.directions.T @ errors.directions
    root = errors.whiten(np.eye(N))  # rows: V^(-1/2) of unit vectors
    np.testing.assert_allclose(root.T @ v @ root, np.eye(N), atol=1e-8)


def test_nuisances_are_removed_exactly(setting):
    projector, signature = setting
    np.testing.assert_allclose(projector.apply(projector.nuisances), 0, atol=1e-9)
    residual = np.random.default_rng(1).normal(size=N)
    shifted = residual + 100 * np.array([1.0, -2.0, 0.5]) @ projector.nuisances
    assert score_effect(projector, residual, signature, [0]).statistic == pytest.approx(
        score_effect(projector, shifted, signature, [0]).statistic, rel=1e-6
    )


def test_planted_dose_comes_back_within_its_error(setting):
    projector, signature = setting
    rng, found = np.random.default_rng(2), []
    for _ in range(200):
        one = score_effect(projector, 0.4 * signature[0] + draw(projector, rng), signature, [0])
        found.append((one.amounts[0] - 0.4) / one.errors[0])
    assert abs(np.mean(found)) < 4 / np.sqrt(200)
    assert np.std(found) == pytest.approx(1, abs=0.2)


def test_silent_on_noise(setting):
    projector, signature = setting
    rng = np.random.default_rng(3)
    for signs in ([0], [1]):
        values = np.array([score_effect(projector, draw(projector, rng), signature, signs).p_value for _ in range(400)])
        assert np.mean(values < 0.05) == pytest.approx(0.05, abs=0.04)


def test_forbidden_sign_scores_nothing(setting):
    projector, signature = setting
    against = score_effect(projector, -3 * signature[0], signature, [1])
    assert against.amounts[0] == 0 and against.p_value == 1.0 and against.statistic == pytest.approx(0, abs=1e-9)


def test_numerical_error_earns_little(setting):
    projector, _ = setting
    error = projector.errors.directions[0]
    plain = Projector(ErrorModel(projector.errors.variance, np.zeros((0, N))), projector.nuisances)
    residual, signature = error, error[None] + 0.01
    assert score_effect(plain, residual, signature, [0]).statistic > 100
    assert score_effect(projector, residual, signature, [0]).statistic < 1.5


def test_vector_effect(setting):
    projector, _ = setting
    rng = np.random.default_rng(4)
    signature = rng.normal(size=(3, N))
    found = score_effect(projector, np.array([1.0, -0.5, 0.2]) @ signature, signature, [0, 0, 1])
    np.testing.assert_allclose(found.amounts, [1, -0.5, 0.2], atol=1e-6)
    assert found.freedom == 3 and found.explained == pytest.approx(1)


def test_error_model_wants_positive_variance():
    with pytest.raises(InputError, match="positive"):
        ErrorModel(np.zeros(3), np.zeros((0, 3)))
