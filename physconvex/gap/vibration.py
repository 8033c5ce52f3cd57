"""Vibrations of the observed and the modelled body: frequency and damping ratio of the few shapes that move most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from physconvex.gap.baseline import Baseline
from physconvex.gap.comparison import Hypothesis
from physconvex.identify import MarkerObservations

__all__ = ["Mode", "ringing", "vibrations"]

_MODES = 3
_FEWEST = 8  # frames that a damped sine is fitted to
_SHARE = 0.02  # of the squares of the deformation: shapes below are left out
_FIT = 0.5  # share of a signal that a damped sine must explain to be one


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


def _damped(p: np.ndarray, t: np.ndarray) -> np.ndarray:
    """a e^(−δt) cos ωt + b e^(−δt) sin ωt + c."""
    decay = np.exp(-p[1] * t)
    return np.asarray(decay * (p[2] * np.cos(p[0] * t) + p[3] * np.sin(p[0] * t)) + p[4])


def ringing(signal: Float[np.ndarray, " T"], fps: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Frequency [Hz] and damping ratio of a signal, and their standard errors; NaN where no damped sine fits it.

    Raises nothing: a signal that does not ring has no frequency.
    """
    nothing = (float("nan"), float("nan"))
    times, total = np.arange(len(signal)) / fps, float(((signal - signal.mean()) ** 2).sum())
    if len(signal) < _FEWEST or total <= 0:
        return nothing, nothing
    best = None
    span = times[-1]
    for cycles in np.geomspace(0.4, 0.4 * len(signal), 14):  # starts; up to 0.8 of the Nyquist frequency
        start = np.array([2 * np.pi * cycles / span, 0.5 / span, *np.linalg.lstsq(
            np.stack([np.cos(2 * np.pi * cycles / span * times), np.sin(2 * np.pi * cycles / span * times),
                      np.ones_like(times)], axis=1), signal, rcond=None)[0]])  # fmt: skip
        found = least_squares(
            lambda p: _damped(p, times) - signal, start, x_scale=np.maximum(np.abs(start), 1e-9), max_nfev=40
        )
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    if 2 * best.cost > (1 - _FIT) * total or best.x[0] * span < np.pi / 2:
        return nothing, nothing
    omega, delta = abs(best.x[0]), best.x[1]
    spread = 2 * best.cost / max(len(signal) - 5, 1)
    covariance = np.linalg.pinv(best.jac.T @ best.jac) * spread
    errors = np.sqrt(np.maximum(np.diag(covariance)[:2], 0.0))
    return (omega / 2 / np.pi, delta / omega), (errors[0] / 2 / np.pi, errors[1] / omega)


def _deformation(positions: Float[np.ndarray, "T P 3"], rest: Float[np.ndarray, "P 3"], held: bool) -> np.ndarray:
    """Displacements, of a free body in the frame that turns and moves with it (Kabsch), shape [T, P, 3]."""
    if held:
        return np.asarray(positions - rest)
    out, centred = np.empty_like(positions), rest - rest.mean(0)
    for t, now in enumerate(positions):
        local = now - now.mean(0)
        u, _, v = np.linalg.svd(local.T @ centred)
        turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
        out[t] = local @ turn - centred
    return out


def vibrations(base: Baseline, best: Hypothesis) -> tuple[Mode, ...]:
    """The shapes that the observed deformation is made of, and how each rings; of markers seen in every frame.

    Of a free body, from the first contact on.
    """
    seen = base.observations
    if not isinstance(seen, MarkerObservations):
        return ()
    points = np.flatnonzero(np.isfinite(seen.positions).all((0, 2)))
    held = base.situation.clamped
    touching = np.flatnonzero(base.contact_force > 0)
    start = 0 if held or not len(touching) else int(touching[0])
    if len(points) < (1 if held else 4) or base.model.frames - start < _FEWEST:
        return ()
    rest = base.motion.rest[points]
    observed, plain, improved = (
        _deformation(p[start:, points], rest, held).reshape(base.model.frames - start, -1)
        for p in (seen.positions, base.positions, best.positions)
    )
    mean = observed.mean(0)
    _, strengths, shapes = np.linalg.svd(observed - mean, full_matrices=False)
    shares = strengths**2 / max(float((strengths**2).sum()), 1e-300)
    fps, out = base.capture.fps, []
    for share, shape in zip(shares[:_MODES], shapes, strict=False):
        if share < _SHARE:
            break
        found, errors = ringing((observed - mean) @ shape, fps)
        out.append(Mode(float(share), found, errors, ringing((plain - mean) @ shape, fps)[0],
                        ringing((improved - mean) @ shape, fps)[0]))  # fmt: skip
    return tuple(out)
