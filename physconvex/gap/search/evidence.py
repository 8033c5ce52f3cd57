"""Information in residuals: mean squares, number of independent ones, and evidence for effects.

All quantities are by kind of residual (`physconvex.gap.base.body_modes`).
"""

from __future__ import annotations

from math import fsum

import numpy as np
from jaxtyping import Bool, Float

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.base.body_modes import temperature
from physconvex.gap.effects.effect import IN_FLIGHT, Effect
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.thresholds import EVIDENCE

ByKind = Float[np.ndarray, " D"]


def mean_square(base: Baseline, errors: ErrorModel, positions: np.ndarray, frames: np.ndarray) -> float:
    """Mean square of some frames' residuals over that of noise and numerical error; NaN without any.

    Kinds of residuals are weighted by their independent ones; the larger value before or from the first contact counts.
    """
    squares, information = squares_by_kind(base, errors, positions, frames), information_by_kind(base, errors, frames)
    found = [
        float(squares[own] @ information[own] / information[own].sum())
        for struck in (False, True)
        if (own := (information > 0) & (base.modes.struck == struck)).any()
    ]
    return max(found, default=float("nan"))


def negative_log_likelihood(base: Baseline, errors: ErrorModel, here: np.ndarray) -> float:
    """Minus the log-likelihood of positions in the first frames, over the fitted ones."""
    fitted = base.split.fitted
    whole = np.concatenate([here, base.positions[len(here) :]])
    return -float(likelihood_by_kind(base, errors, whole, fitted[fitted < len(here)]).sum())


def squares_by_kind(base: Baseline, errors: ErrorModel, positions: np.ndarray, frames: np.ndarray) -> ByKind:
    """Mean square of the residuals of each kind over that of noise and numerical error; NaN without any."""
    rows = base.rows(frames)
    kinds = base.modes.kinds[rows]
    total = np.bincount(kinds, base.residual(positions)[rows] ** 2 / errors.expected[rows], minlength=base.modes.count)
    count = np.bincount(kinds, minlength=base.modes.count)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _alike(base: Baseline, errors: ErrorModel, positions: np.ndarray, frames: np.ndarray) -> ByKind:
    """Residuals per independent one, by kind, see `physconvex.gap.base.body_modes`."""
    rows, out = base.rows(frames), np.ones(base.modes.count)
    whitened = base.residual(positions)[rows] / np.sqrt(errors.expected[rows])
    for kind in range(base.modes.count):
        own = base.modes.kinds[rows] == kind
        if own.any():
            out[kind] = temperature(whitened[own], base.observations.frames[rows][own], base.columns[rows][own])
    return out


def residuals_per_one(base: Baseline, errors: ErrorModel, positions: np.ndarray, frames: np.ndarray) -> float:
    """Residuals per independent one in the residual of a model, in some frames."""
    rows = base.rows(frames)
    count = np.bincount(base.modes.kinds[rows], minlength=base.modes.count)
    return float(count.sum() / (count / _alike(base, errors, positions, frames)).sum())


def information_by_kind(base: Baseline, errors: ErrorModel, frames: np.ndarray) -> ByKind:
    """Number of independent residuals by kind: each counts by the share of noise in its variance.

    Smooth errors count by half of their degrees of freedom in two frames.
    """
    rows, modes, total = base.rows(frames), base.modes, base.model.frames
    place = modes.kinds[rows] * total + base.observations.frames[rows]
    shape = (modes.count, total)
    count = np.bincount(place, minlength=shape[0] * shape[1]).reshape(shape)
    noise = np.bincount(place, 1 / errors.variance[rows], minlength=count.size).reshape(shape)
    smooth = np.minimum(noise + modes.independent[:, None], count)
    return np.asarray(np.where(count > 0, smooth, 0.0).sum(1))


def information_per_one(base: Baseline, errors: ErrorModel, positions: np.ndarray) -> ByKind:
    """Divisor of the likelihood of each kind, so that no more residuals count than are independent.

    Residuals that share their numerical error already count as few (`information_by_kind`). The smaller of that number
    and of the independent ones in a model's residual applies, since both describe the same correlation.
    """
    frames = np.union1d(base.split.fitted, base.split.selecting)
    count = np.bincount(base.modes.kinds[base.rows(frames)], minlength=base.modes.count)
    independent = count / _alike(base, errors, positions, frames)
    return np.maximum(1.0, information_by_kind(base, errors, frames) / np.maximum(independent, 1e-9))


def likelihood_by_kind(base: Baseline, errors: ErrorModel, positions: np.ndarray | None, frames: np.ndarray) -> ByKind:
    """−n/2 ln(mean square) with unknown scale, by kind; the mean square is over that of noise and numerical error.

    A mean square below one adds little. Without positions: of a model that leaves only noise and numerical error.
    """
    information = information_by_kind(base, errors, frames)
    squares = np.ones(base.modes.count) if positions is None else squares_by_kind(base, errors, positions, frames)
    return np.asarray(-0.5 * information * np.log(np.where(information > 0, squares, 1.0) + EVIDENCE.enough))


def evidence_of(
    likelihood: np.ndarray, information: np.ndarray, effects: tuple[Effect, ...], values: np.ndarray,
    divisor: np.ndarray | float = 1.0, *, struck: np.ndarray | None = None, deviations: np.ndarray | None = None,
) -> float:  # fmt: skip
    """Likelihood less ½ k ln n for k doses, as much again for every further effect, and less the prior penalty.

    n is the number of independent residuals that inform a dose. Residuals of a flight do not inform effects that act
    through deformation or contact, nor errors of a rebound. A shape dose with a stated prior costs only the information
    that the recording adds to it (Laplace). Otherwise the place of a load, which a light one does not determine, costs
    as much as its mass, and a wrong frame rate is called instead.

    Args:
        likelihood: by kind.
        information: number of independent fitted residuals by kind, of those that the effects change.
        effects: effects of the fit.
        values: base parameters, then doses.
        divisor: residuals of a kind per independent one.
        struck: kinds of frames from the first contact on; None if there are no others.
        deviations: standard errors of the values.
    """
    independent = information / divisor
    whole = float(independent.sum())
    late = whole if struck is None or not independent[struck].any() else float(independent[struck].sum())
    doses = [dose for effect in effects for dose in effect.doses]
    first = len(values) - len(doses)
    # of one dose of each effect
    prices = [0.5 * float(np.log(max(whole if e.source in IN_FLIGHT else late, 2.0))) for e in effects]
    paid = [price for effect, price in zip(effects, prices, strict=True) for _ in effect.doses]
    if deviations is not None:
        paid = [min(one, d.narrowed(e)) for one, d, e in zip(paid, doses, deviations[first:], strict=True)]
    # a physical cause precedes a numerical one with the same signature
    paid += [price for effect, price in zip(effects, prices, strict=True) if effect.source == "numerical"]
    price = fsum([*paid, *sorted(prices)[:-1]])  # independent of the order of the effects
    odd = sum(dose.implausibility(value) for dose, value in zip(doses, values[first:], strict=True))
    return float((likelihood / divisor).sum() - price - odd)


def moved_kinds(base: Baseline, errors: ErrorModel, positions: np.ndarray) -> Bool[np.ndarray, " D"]:
    """Kinds of residuals that differ visibly from the base fit's in the fitted frames; all if none does."""
    rows = base.rows(base.split.fitted)
    kinds = base.modes.kinds[rows]
    squares = (base.residual(positions) - base.residual(base.positions))[rows] ** 2 / errors.expected[rows]
    total = np.bincount(kinds, squares, minlength=base.modes.count)
    seen = total > EVIDENCE.unseen * np.maximum(np.bincount(kinds, minlength=base.modes.count), 1)
    return np.asarray(seen if seen.any() else np.ones_like(seen))
