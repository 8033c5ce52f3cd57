"""Calibration repairs over- and underconfident densities, and its intervals cover new values."""

import numpy as np
import pytest
import torch

from models import BinConfig, Calibration, DensityCalibration, fit_density_calibration
from physconvex import InputError

BINS = BinConfig(low=-4.0, high=4.0, bins=160)


def normal_logits(centres: torch.Tensor, sigma: float) -> torch.Tensor:
    middles = torch.linspace(BINS.low, BINS.high, BINS.bins + 1)[:-1] + (BINS.high - BINS.low) / BINS.bins / 2
    return -0.5 * ((middles - centres[:, None]) / sigma).square()


def case(count: int, seed: int, claimed: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Values about centres with standard deviation 0.4, of which the network claims `claimed`."""
    generator = torch.Generator().manual_seed(seed)
    centres = torch.rand(count, generator=generator) * 2 - 1
    return normal_logits(centres, claimed), centres + 0.4 * torch.randn(count, generator=generator)


@pytest.mark.parametrize("claimed", [0.25, 0.4, 0.6])
def test_temperature_and_coverage(claimed: float) -> None:
    """A normal density at temperature τ has τ times the variance, so τ should be (0.4 / claimed)²."""
    fit = fit_density_calibration(*case(2000, 0, claimed), BINS)
    assert fit.temperature == pytest.approx((0.4 / claimed) ** 2, rel=0.2)
    logits, values = case(4000, 1, claimed)
    low, high = fit.interval(fit.density(logits, BINS))
    covered = float(((low <= values) & (values <= high)).float().mean())
    assert covered == pytest.approx(0.9, abs=0.02)  # 3 σ of 4000 and of 2000 draws


def test_conformal_level_covers_where_the_shape_is_wrong() -> None:
    """Heavy tails that no temperature repairs: a tenth of the values is anywhere."""
    logits, values = case(3000, 2, 0.1)
    wild = torch.rand(3000, generator=torch.Generator().manual_seed(5)) < 0.1
    values = torch.where(wild, torch.rand(3000, generator=torch.Generator().manual_seed(6)) * 8 - 4, values)
    fit = fit_density_calibration(logits[:1500], values[:1500], BINS)
    low, high = fit.interval(fit.density(logits[1500:], BINS))
    covered = float(((low <= values[1500:]) & (values[1500:] <= high)).float().mean())
    assert covered == pytest.approx(0.9, abs=0.03)


def test_few_clips_are_refused_and_nine_take_the_widest() -> None:
    logits, values = case(9, 3, 0.4)
    with pytest.raises(InputError, match="at least 9"):
        fit_density_calibration(logits[:8], values[:8], BINS)
    fit = fit_density_calibration(logits, values, BINS)
    pit = fit.density(logits, BINS).cdf(values)
    assert fit.central_level == pytest.approx(float((2 * pit - 1).abs().max()), abs=1e-6)


def test_json_round_trip() -> None:
    calibration = Calibration(stiffness=DensityCalibration(temperature=1.7, central_level=0.83), clips=12)
    assert Calibration.model_validate_json(calibration.model_dump_json()) == calibration
    assert np.isclose(calibration.poisson.temperature, 1.0)
