"""Frames with a large model error get a smaller weight.

e_t is the rms, over the residuals of frame t, of the whitened difference between two discretisations of the full model.
Each residual of that frame is divided by √(1 + e_t²): noise and model error count as independent variances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from physconvex.identify.observations import Observations, WrappedObservations


def frame_errors(
    seen: Observations, fine: Float[np.ndarray, "T P 3"], coarse: Float[np.ndarray, "T P 3"]
) -> Float[np.ndarray, " T"]:
    """e_t: rms of the whitened difference of two models' positions [m] in each frame, in standard deviations."""
    change = seen.residuals(fine) - seen.residuals(coarse)
    counts = np.bincount(seen.frames, minlength=len(fine))
    return np.sqrt(np.bincount(seen.frames, change**2, minlength=len(fine)) / np.maximum(counts, 1))


@dataclass(frozen=True, eq=False)
class WeightedObservations(WrappedObservations):
    """Observations with a factor on the residuals of each frame.

    Attributes:
        seen: the observations.
        factors: by frame, shape [T].
    """

    factors: Float[np.ndarray, " T"]

    @classmethod
    def by_errors(cls, seen: Observations, errors: Float[np.ndarray, " T"]) -> WeightedObservations:
        """Factors 1/√(1 + e_t²)."""
        return cls(seen, 1.0 / np.sqrt(1.0 + np.square(errors)))

    def in_frames(self, count: int) -> WeightedObservations:
        """The first `count` frames alone; the points stay."""
        return WeightedObservations(self.seen.in_frames(count), self.factors[:count])

    def residuals(self, positions: Float[np.ndarray, "T P 3"]) -> Float[np.ndarray, " N"]:
        """(model − seen)/σ times the factors."""
        return self.factors[self.frames] * self.seen.residuals(positions)

    def linearise(
        self, positions: Float[np.ndarray, "T P 3"], tangents: Float[np.ndarray, "T K P 3"]
    ) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N K"]]:
        """The residuals and their derivatives."""
        residuals, jacobian = self.seen.linearise(positions, tangents)
        factors = self.factors[self.frames]
        return factors * residuals, factors[:, None] * jacobian
