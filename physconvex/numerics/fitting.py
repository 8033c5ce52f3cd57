"""Parts of fits: derivatives updated by changes of the function itself (Broyden 1965), and Huber's loss."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

_STILL = 1e-8  # square of a step, in typical ones, below which it is ignored


def moved_along(slope: Float[np.ndarray, "T K P 3"], step: Float[np.ndarray, " K"]) -> Float[np.ndarray, "T P 3"]:
    """Change over a step by the derivatives."""
    return np.einsum("tkpi,k->tpi", slope, step)


def broyden_update(
    slope: Float[np.ndarray, "T K P 3"],
    step: Float[np.ndarray, " K"],
    change: Float[np.ndarray, "T P 3"],
    scales: Float[np.ndarray, " K"],
    *,
    still: float = _STILL,
) -> Float[np.ndarray, "T K P 3"]:
    """The slope closest to the given one, steps in typical lengths, that explains a change.

    Args:
        slope: D.
        step: Δp.
        change: of the function.
        scales: typical lengths of the K steps.
        still: square of a step, in typical ones, below which it is ignored.
    """
    scaled = step / scales
    square = float(scaled @ scaled)
    if square < still:
        return slope
    unexplained = change - moved_along(slope, step)
    return np.asarray(slope + unexplained[:, None] * (scaled / scales / square)[None, :, None, None])


def huber_loss(residuals: Float[np.ndarray, " N"], limits: Float[np.ndarray, " N"]) -> float:
    """Σ r²/2 where |r| ≤ k, k (|r| − k/2) beyond (Huber 1964); k = inf is least squares."""
    size = np.abs(residuals)
    inside = size <= limits
    straight = limits[~inside] * (size[~inside] - 0.5 * limits[~inside])
    return 0.5 * float((size[inside] ** 2).sum()) + float(straight.sum())


def huber_weights(residuals: Float[np.ndarray, " N"], limits: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Weights min(1, k/|r|) for which least squares have the gradient of that loss."""
    return np.minimum(1.0, limits / np.maximum(np.abs(residuals), 1e-300))
