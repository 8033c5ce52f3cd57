"""The similarity law, exactly."""

import numpy as np
import pytest

from models import dimensionless_interval, log10_dimensionless_stiffness
from models.scaling import GRAVITY, log10_youngs_modulus
from physconvex import InputError


def test_there_and_back() -> None:
    modulus = np.array([1e4, 3e5, 1e7])
    scale = {"density": np.array([1000.0, 300.0, 7800.0]), "object_size": np.array([0.1, 1.0, 2.5])}
    stiffness = log10_dimensionless_stiffness(modulus, **scale)
    np.testing.assert_allclose(10 ** log10_youngs_modulus(stiffness, **scale), modulus, rtol=1e-14)


def test_twice_the_size_at_one_root_two_of_the_rate_is_twice_the_modulus() -> None:
    """Equal dimensionless motion: t √(g/L) and E/(ρ g L) are those of the first body."""
    size, fps = 0.37, 60.0
    first = dimensionless_interval(fps, object_size=size)
    assert dimensionless_interval(fps / np.sqrt(2), object_size=2 * size) == pytest.approx(first, rel=1e-15)
    small = log10_youngs_modulus(1.3, density=1000.0, object_size=size)
    large = log10_youngs_modulus(1.3, density=1000.0, object_size=2 * size)
    assert 10 ** (large - small) == pytest.approx(2.0, rel=1e-14)


def test_free_fall_is_the_same_in_dimensionless_time() -> None:
    """A fall of half a body length takes one unit of time whatever the size: ½ g t² = L/2 at t = √(L/g)."""
    for size in (0.05, 1.0, 20.0):
        fps = 1 / np.sqrt(size / GRAVITY)
        assert dimensionless_interval(fps, object_size=size) == pytest.approx(1.0)


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_sizes_are_refused(bad: float) -> None:
    with pytest.raises(InputError, match="object_size"):
        log10_youngs_modulus(1.0, density=1000.0, object_size=bad)
    with pytest.raises(InputError, match="fps"):
        dimensionless_interval(bad, object_size=1.0)
