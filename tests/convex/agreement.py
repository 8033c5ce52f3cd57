"""Whether one implementation computes what another does."""

from __future__ import annotations

from torch import Tensor

__all__ = ["assert_agrees"]


def assert_agrees(
    found: Tensor, expected: Tensor, *, relative: float, name: str = "values", floor: float = 0.0
) -> None:
    """Compare elementwise, as a whole, in direction and in sum; what is nowhere above `floor` counts as zero.

    Raises:
        AssertionError: the greatest deviation exceeds ten times `relative` of the greatest value, the norm of the
            deviation `relative` of the norm, the angle between both as vectors `relative`, or the mean deviation
            `relative` of the mean magnitude.
    """
    assert found.shape == expected.shape, f"{name}: shape {tuple(found.shape)} instead of {tuple(expected.shape)}"
    found, expected = found.detach().double().flatten(), expected.detach().double().flatten()
    assert found.isfinite().all(), f"{name}: not finite"
    if not found.numel():
        return
    greatest, norm = expected.abs().max(), expected.norm()
    if greatest <= floor:
        assert found.abs().max() <= floor, f"{name}: {found.abs().max()} where all should be zero"
        return
    off = found - expected
    assert off.abs().max() <= 10 * relative * greatest, f"{name}: off by {off.abs().max()} of {greatest}"
    assert off.norm() <= relative * norm, f"{name}: relative deviation {off.norm() / norm}"
    # sin² of the angle, without the cancellation of 1 − cos²
    across = found - expected * (found @ expected) / norm**2
    assert across.norm() <= relative * found.norm(), f"{name}: another direction, by {across.norm() / found.norm()} rad"
    assert off.mean().abs() <= relative * expected.abs().mean(), f"{name}: biased by {off.mean()}"
