"""How many of the residuals are independent: what a model leaves is smooth in time and alike among points.

Noise is independent from residual to residual, the lack of fit of a model is not: where most of what is left is lack
of fit, n residuals count for as few as there are independent ones, and log-likelihoods are divided by the ratio
(a tempered, or fractional, likelihood). A model that fits within its error is judged as before.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from physconvex.gap.thresholds import EVIDENCE

__all__ = ["temperature"]


def temperature(
    whitened: Float[np.ndarray, " N"], frames: Int[np.ndarray, " N"], columns: Int[np.ndarray, " N"]
) -> float:
    """Residuals per independent one; 1 for noise alone.

    Their table of frames by columns has a participation ratio of shapes, and a correlation from frame to frame; the
    product of the independent shapes and moments is counted for the part of the mean square that exceeds one.

    Args:
        whitened: residuals over what noise and numerical error lead one to expect.
        frames: frame of each.
        columns: what in the frame each is of (point and coordinate).
    """
    excess = 1.0 - 1.0 / max(float(np.mean(whitened**2)), 1.0) if len(whitened) else 0.0
    seen, rows = np.unique(frames, return_inverse=True)
    if excess <= 0 or len(seen) < 2:
        return 1.0
    table = np.zeros((len(seen), int(columns.max()) + 1))
    table[rows, columns] = whitened
    strengths = np.linalg.svd(table, compute_uv=False) ** 2
    shapes = float(strengths.sum() ** 2 / (strengths**2).sum())
    lasting = float(np.clip((table[1:] * table[:-1]).sum() / (table**2).sum(), 0.0, 1.0))
    moments = len(seen) * max((1 - lasting) / (1 + lasting), EVIDENCE.smooth)
    return max(1.0, 1.0 + excess * (len(whitened) / (shapes * moments) - 1.0))
