"""Vibration of a signal as a damped sine, and the likelihood of a model with another vibration.

Frequency and damping ratio of the dominant shape determine a held body's stiffness, mass and damping, however and
whenever its motion starts. An explanation must reproduce them. Evidence that is tempered for correlated residuals loses
most of this information. It therefore enters once more, as two observations with the errors of a good model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import OptimizeResult, least_squares

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.thresholds import EVIDENCE
from physconvex.identify import MarkerObservations
from physconvex.numerics import beyond_rigid


def _damped(p: np.ndarray, t: np.ndarray) -> np.ndarray:
    """a e^(−δt) cos ωt + b e^(−δt) sin ωt + c."""
    decay = np.exp(-p[1] * t)
    return np.asarray(decay * (p[2] * np.cos(p[0] * t) + p[3] * np.sin(p[0] * t)) + p[4])


def damped_sine_fit(signal: Float[np.ndarray, " T"], fps: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Frequency [Hz] and damping ratio of a signal, and their standard errors; NaN if no damped sine fits it.

    Raises nothing: a signal that does not vibrate has no frequency.
    """
    nothing = (float("nan"), float("nan"))
    times, total = np.arange(len(signal)) / fps, float(((signal - signal.mean()) ** 2).sum())
    if len(signal) < EVIDENCE.ringing_frames or total <= 0:
        return nothing, nothing
    span = times[-1]

    def fitted(omega: float) -> OptimizeResult:
        columns = np.stack([np.cos(omega * times), np.sin(omega * times), np.ones_like(times)], axis=1)
        start = np.array([omega, 0.5 / span, *np.linalg.lstsq(columns, signal, rcond=None)[0]])
        scale = np.maximum(np.abs(start), 1e-9)
        return least_squares(lambda p: _damped(p, times) - signal, start, x_scale=scale, max_nfev=40)

    cycles = np.geomspace(0.4, 0.4 * len(signal), 14)  # starts; up to 0.8 of the Nyquist frequency
    best = min((fitted(2 * np.pi * count / span) for count in cycles), key=lambda found: found.cost)
    if 2 * best.cost > (1 - EVIDENCE.ringing_explained) * total or best.x[0] * span < np.pi / 2:
        return nothing, nothing
    omega, delta = abs(best.x[0]), best.x[1]
    spread = 2 * best.cost / max(len(signal) - 5, 1)
    covariance = np.linalg.pinv(best.jac.T @ best.jac) * spread
    errors = np.sqrt(np.maximum(np.diag(covariance)[:2], 0.0))
    return (omega / 2 / np.pi, delta / omega), (errors[0] / 2 / np.pi, errors[1] / omega)


def deformation(positions: Float[np.ndarray, "T P 3"], rest: Float[np.ndarray, "P 3"], held: bool) -> np.ndarray:
    """Displacements, for a free body in the frame that turns and moves with it (Kabsch), shape [T, P, 3]."""
    if held:
        return np.asarray(positions - rest)
    moved, turns = beyond_rigid(rest, positions)
    return moved @ turns


@dataclass(frozen=True, eq=False)
class Recorded:
    """Vibration of the dominant shape in a recording of a held body.

    Attributes:
        frequency, ratio: [Hz], and the damping ratio.
        errors: standard errors of the two.
        shape: unit vector of the observed coordinates, shape [3 P].
        mean: mean about which the shape vibrates [m], shape [3 P].
        points: points that are seen in every frame.
        frames: number of frames used, without those reserved for the report.
    """

    frequency: float
    ratio: float
    errors: tuple[float, float]
    shape: Float[np.ndarray, " N"]
    mean: Float[np.ndarray, " N"]
    points: Int[np.ndarray, " P"]
    frames: int


def _displacements(base: Baseline, positions: Float[np.ndarray, "T P 3"], points: np.ndarray, count: int) -> np.ndarray:
    return (positions[:count, points] - base.motion.rest[points]).reshape(count, -1)


def recorded_ringing(base: Baseline) -> Recorded | None:
    """Vibration of the recording of a held body; None if it does not vibrate, or has no markers."""
    seen = base.observations
    if not base.situation.clamped or not isinstance(seen, MarkerObservations):
        return None
    points = np.flatnonzero(np.isfinite(seen.positions).all((0, 2)))
    count = int(max(base.split.fitted.max(), base.split.selecting.max(initial=0))) + 1
    if not len(points) or count < EVIDENCE.ringing_frames:
        return None
    shown = _displacements(base, seen.positions, points, count)
    mean = shown.mean(0)
    _, strengths, shapes = np.linalg.svd(shown - mean, full_matrices=False)
    if strengths[0] ** 2 < EVIDENCE.main_shape * float((strengths**2).sum()):
        return None
    (frequency, ratio), errors = damped_sine_fit((shown - mean) @ shapes[0], base.capture.fps)
    if not np.isfinite(frequency) or not errors[0] < EVIDENCE.frequency_told * frequency:
        return None
    return Recorded(frequency, ratio, errors, shapes[0], mean, points, count)


def damped_sine_likelihood(base: Baseline, positions: Float[np.ndarray, "T P 3"]) -> float:
    """Log-likelihood of the recorded frequency and damping ratio for a model with `positions`; for held bodies.

    Zero if the recording does not vibrate, or has no markers. Frames reserved for the report are left out.
    """
    recorded = recorded_ringing(base)
    if recorded is None:
        return 0.0
    modelled = _displacements(base, positions, recorded.points, recorded.frames)
    own_frequency, own_ratio = damped_sine_fit((modelled - recorded.mean) @ recorded.shape, base.capture.fps)[0]
    if not np.isfinite(own_frequency):
        return -0.5 * EVIDENCE.ringing_farthest**2
    (error, ratio_error), frequency, ratio = recorded.errors, recorded.frequency, recorded.ratio
    damping = max(EVIDENCE.damping_missed * abs(ratio), EVIDENCE.least_damping_missed)
    missed = np.array([
        (own_frequency - frequency) / np.hypot(error, EVIDENCE.frequency_missed * frequency),
        (own_ratio - ratio) / np.hypot(ratio_error, damping),
    ])  # fmt: skip
    return -0.5 * float((np.minimum(np.abs(missed), EVIDENCE.ringing_farthest) ** 2).sum())
