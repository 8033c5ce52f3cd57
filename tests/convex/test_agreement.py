"""The comparison of kernels with the reference sees what it should see."""

import pytest
import torch

from tests.convex.agreement import assert_agrees


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda x: torch.cat([x[:-1] * 1.0, x[-1:] + 1.0]), "off by"),
        (lambda x: x * 1.002, "relative deviation"),
        (lambda x: x[:10], "shape"),
        (lambda x: x * torch.nan, "not finite"),
        (lambda x: x + 0.0009 * x.abs().mean(), "biased"),
    ],
)
def test_deviations_are_refused(change, message: str) -> None:
    values = torch.randn(200, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    assert_agrees(values + 1e-5 * values.flip(0), values, relative=1e-3)
    relative = 8e-4 if message == "biased" else 1e-3
    with pytest.raises(AssertionError, match=message):
        assert_agrees(change(values), values, relative=relative)


def test_zero_must_be_zero() -> None:
    zero = torch.zeros(5)
    assert_agrees(zero, zero, relative=1e-3)
    with pytest.raises(AssertionError, match="should be zero"):
        assert_agrees(zero + 1e-9, zero, relative=1e-3)


def test_what_is_nowhere_above_the_floor_counts_as_zero() -> None:
    slight = 1e-9 * torch.ones(5)
    assert_agrees(0 * slight, slight, relative=1e-3, floor=1e-8)
    with pytest.raises(AssertionError, match="off by"):
        assert_agrees(0 * slight, slight, relative=1e-3)
    with pytest.raises(AssertionError, match="should be zero"):
        assert_agrees(1e3 * slight, slight, relative=1e-3, floor=1e-8)
