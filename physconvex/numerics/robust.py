"""Huber's loss: squares of small residuals, straight lines beyond a threshold."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def huber_loss(residuals: Float[np.ndarray, " N"], limits: Float[np.ndarray, " N"]) -> float:
    """Σ r²/2 where |r| ≤ k, k (|r| − k/2) beyond (Huber 1964); k = inf is least squares."""
    size = np.abs(residuals)
    inside = size <= limits
    straight = limits[~inside] * (size[~inside] - 0.5 * limits[~inside])
    return 0.5 * float((size[inside] ** 2).sum()) + float(straight.sum())


def huber_weights(residuals: Float[np.ndarray, " N"], limits: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Weights min(1, k/|r|) for which least squares have the gradient of that loss."""
    return np.minimum(1.0, limits / np.maximum(np.abs(residuals), 1e-300))
