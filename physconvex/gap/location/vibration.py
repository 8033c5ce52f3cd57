"""Vibrations of the observed and the modelled body: frequency and damping ratio of the few shapes that move most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.search.damped_sine import deformation, ringing
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.thresholds import EVIDENCE, LOCALISATION
from physconvex.identify import MarkerObservations

__all__ = ["Mode", "vibrations"]


@dataclass(frozen=True)
class Mode:
    """One shape of the observed deformation, and how it rings.

    Attributes:
        share: of the squares of the observed deformation.
        observed, base, improved: (frequency [Hz], damping ratio) of the recording, of the base model, and of the model
            with the best effects; NaN where the signal is no damped sine.
        errors: standard errors of the observed pair.
    """

    share: float
    observed: tuple[float, float]
    errors: tuple[float, float]
    base: tuple[float, float]
    improved: tuple[float, float]


def vibrations(base: Baseline, best: Hypothesis) -> tuple[Mode, ...]:
    """The shapes that the observed deformation is made of, and how each rings; of markers seen in every frame.

    Of a free body, from the first contact on.
    """
    seen = base.observations
    if not isinstance(seen, MarkerObservations):
        return ()
    points = np.flatnonzero(np.isfinite(seen.positions).all((0, 2)))
    held = base.situation.clamped
    start = 0 if held else base.first_contact or 0
    if len(points) < (1 if held else 4) or base.model.frames - start < EVIDENCE.ringing_frames:
        return ()
    rest = base.motion.rest[points]
    observed, plain, improved = (
        deformation(p[start:, points], rest, held).reshape(base.model.frames - start, -1)
        for p in (seen.positions, base.positions, best.positions)
    )
    mean = observed.mean(0)
    _, strengths, shapes = np.linalg.svd(observed - mean, full_matrices=False)
    shares = strengths**2 / max(float((strengths**2).sum()), 1e-300)
    fps, out = base.capture.fps, []
    for share, shape in zip(shares[: LOCALISATION.shapes], shapes, strict=False):
        if share < LOCALISATION.shape_share:
            break
        found, errors = ringing((observed - mean) @ shape, fps)
        out.append(Mode(float(share), found, errors, ringing((plain - mean) @ shape, fps)[0],
                        ringing((improved - mean) @ shape, fps)[0]))  # fmt: skip
    return tuple(out)
