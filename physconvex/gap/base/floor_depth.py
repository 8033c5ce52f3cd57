"""How deep a body is seen to lie in the floor."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from physconvex.gap.base.observed_points import Seen
from physconvex.identify import MarkerObservations
from physconvex.io import Capture

__all__ = ["depth_seen"]


def depth_seen(capture: Capture, seen: Seen, frames: Int[np.ndarray, " F"]) -> float:
    """How deep markers lie in the floor [m]: the second deepest, noise taken off; 0 without markers or floor.

    What frame 0 lies off its rest state by counts as a shift of the markers' frame.

    Args:
        capture: of which the floor is taken.
        seen: the observations.
        frames: in which it is looked for.
    """
    if not isinstance(seen, MarkerObservations) or capture.floor is None:
        return 0.0
    normal = np.asarray(capture.floor.normal) / np.linalg.norm(capture.floor.normal)

    first = (seen.positions[0] - seen.points) @ normal
    shift = float(np.nanmean(first)) if np.isfinite(first).any() else 0.0
    height = (seen.positions[frames] - np.asarray(capture.floor.point)) @ normal - shift + 4 * seen.sigma[frames]
    deep = np.sort(-height[np.isfinite(height)])
    return max(float(deep[-2]), 0.0) if len(deep) > 1 else 0.0
