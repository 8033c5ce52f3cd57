"""Densities over bins: moments, quantiles and scores against their definitions."""

import numpy as np
import pytest
import torch

from models import BinConfig, BinnedDensity

BINS = BinConfig(low=-1.0, high=2.0, bins=12)


@pytest.fixture
def density() -> BinnedDensity:
    return BinnedDensity.from_logits(torch.randn(5, 12, generator=torch.Generator().manual_seed(3)), BINS)


def draws(density: BinnedDensity, count: int = 200_000) -> np.ndarray:
    generator = np.random.default_rng(0)
    edges, p = density.edges.numpy(), density.probabilities.numpy().astype(np.float64)
    rows = []
    for row in p:
        place = generator.choice(len(row), size=count, p=row / row.sum())
        rows.append(edges[place] + generator.random(count) * np.diff(edges)[place])
    return np.stack(rows)


def test_moments_are_those_of_draws(density: BinnedDensity) -> None:
    samples = draws(density)
    np.testing.assert_allclose(density.mean(), samples.mean(axis=1), atol=0.01)
    np.testing.assert_allclose(density.std(), samples.std(axis=1), atol=0.01)


@pytest.mark.parametrize("level", [0.0, 0.05, 0.37, 0.5, 0.95, 1.0])
def test_quantile_inverts_cdf(density: BinnedDensity, level: float) -> None:
    quantile = density.quantile(level)
    np.testing.assert_allclose(density.cdf(quantile), level, atol=1e-5)
    assert ((quantile >= BINS.low) & (quantile <= BINS.high)).all()


def test_crps_is_its_integral(density: BinnedDensity) -> None:
    """Against the trapezoidal rule on a grid of 30,000 points."""
    truth = torch.tensor([-0.9, 0.1, 0.77, 1.99, -1.0])
    grid = torch.linspace(BINS.low, BINS.high, 30_001)
    for k, value in enumerate(truth):
        row = BinnedDensity(density.edges, density.probabilities[k].expand(len(grid), -1))
        integrand = (row.cdf(grid) - (grid >= value).float()).square()
        assert float(density.crps(truth)[k]) == pytest.approx(float(torch.trapezoid(integrand, grid)), abs=2e-4)


def test_crps_is_proper() -> None:
    """On average over draws of a density, no other density scores better than that density."""
    logits = torch.tensor([[0.0, 1.0, 2.0, 0.5, -1.0, 0.0, 0.3, 0.0, 0.0, 1.5, 0.0, 0.0]])
    true = BinnedDensity.from_logits(logits, BINS)
    samples = torch.from_numpy(draws(true)[0]).float()

    def score(temperature: float) -> float:
        other = BinnedDensity.from_logits(logits, BINS, temperature=temperature)
        return float(BinnedDensity(other.edges, other.probabilities.expand(len(samples), -1)).crps(samples).mean())

    assert score(1.0) < min(score(0.5), score(2.0))


def test_certainty_and_ignorance() -> None:
    logits = torch.full((2, 12), 0.0)
    logits[0, 4] = 100.0  # bin 4 is [0, 0.25)
    density = BinnedDensity.from_logits(logits, BINS)
    np.testing.assert_allclose(density.quantile(0.5), [0.125, 0.5], atol=1e-5)
    np.testing.assert_allclose(density.std(), [0.25 / np.sqrt(12), 3 / np.sqrt(12)], rtol=1e-5)
