"""How much of the numerical error that other meshes lead one to expect is really there: no fit can err by less than it.

What a mesh of 250 nodes and one of 1000 differ by after an impact may be many times what the finer one errs by, and an
effect that is smaller is then lost in it. But the residual of the fitted frames is error and effect together. If the
base model, or it with one effect, leaves a tenth of the expected error, then the error is no larger than that tenth
(unless the two cancel all the time). As in a regression, the scale of the errors comes from the largest model. A margin
keeps what an effect absorbs of numerical error by chance from being called a cause, and what unknowns absorb of few
independent residuals is made up for by their leverage, as degrees of freedom are in a regression.

After the fitted frames differences between meshes grow on. Of these frames (the first half of them chooses between
fits) no more is believed than what the base model leaves there, with the same margin.

Each kind of residual (`physconvex.gap.base.body_modes`) has a scale of its own: a rebound that is off says nothing of
strains.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.gap.base.baseline import Baseline, derivatives_of_residuals
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.errors.screening import Screening
from physconvex.gap.thresholds import NUMERICAL_ERROR

__all__ = ["error_scale"]


def error_scale(base: Baseline, errors: ErrorModel, screening: Screening) -> Float[np.ndarray, " N"]:
    """Factor on the numerical error of each residual, 0.15 to 1.

    Args:
        base: the base fit.
        errors: with the numerical error as other meshes, steps and contact have it.
        screening: of the effects at that fit; each may explain what it can to first order, numerical ones not.
    """
    last, kinds = int(base.split.fitted[-1]), base.modes.kinds
    fitted = _fitted_scale(base, errors, screening)
    rows = base.rows(base.split.selecting)
    unfitted = (base.residual(base.positions)[rows], np.zeros(len(rows)))
    late = np.minimum(fitted, _scale(base, errors, rows, [unfitted]))
    return np.where(base.observations.frames > last, late[kinds], fitted[kinds])


def _fitted_scale(base: Baseline, errors: ErrorModel, screening: Screening) -> Float[np.ndarray, " K"]:
    """By kind, of the fitted frames."""
    rows = base.rows(base.split.fitted)
    weights = 1 / np.sqrt(errors.expected[rows])
    count = base.split.end
    here = base.positions[:count]
    tangents = derivatives_of_residuals(base, here, base.tangents[:count])[:, rows]
    residual = base.residual(base.positions)[rows]
    candidates: list[list[np.ndarray]] = [[]]
    for entry in screening.one_per_name:
        if entry.effect.source != "numerical" and np.any(entry.score.amounts):
            signature = np.tensordot(entry.score.amounts, entry.signature, 1)
            candidates.append([base.change(here + signature)[rows]])
    return _scale(base, errors, rows, [_left(residual, [*tangents, *columns], weights) for columns in candidates])


def _scale(
    base: Baseline, errors: ErrorModel, rows: np.ndarray, fits: list[tuple[np.ndarray, np.ndarray]]
) -> Float[np.ndarray, " K"]:  # fmt: skip
    """Twice what the best of several fits leaves in some rows over the numerical error expected there, by kind.

    Args:
        base: the base fit.
        errors: what is expected.
        rows: the residuals.
        fits: what each leaves of them, and the leverage of each residual.
    """
    numerical, out = errors.expected[rows] - 1.0, np.ones(base.modes.count)
    for kind in range(base.modes.count):
        told = (numerical > 1.0) & (base.modes.kinds[rows] == kind)
        frames = np.unique(base.observations.frames[rows][told])
        if len(frames) < NUMERICAL_ERROR.scale_frames:
            continue
        weights = numerical[told] / errors.expected[rows][told] ** 2  # as the likelihood of one scale weighs them
        expected = float(weights @ numerical[told])
        independent = max(len(frames) * float(base.modes.independent[kind]), 1.0)
        shares = []
        for left, leverage in fits:
            free = max(1.0 - float(leverage[told].sum()) / independent, NUMERICAL_ERROR.free_residuals)
            shares.append(max(float(weights @ (left[told] ** 2 - 1.0)), 0.0) / expected / free)
        out[kind] = np.clip(np.sqrt(NUMERICAL_ERROR.scale_margin * min(shares)), NUMERICAL_ERROR.least_scale, 1.0)
    return out


def _left(
    residual: Float[np.ndarray, " n"], columns: list[np.ndarray], weights: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """What a weighted regression on the columns leaves, and the leverage of each row."""
    x = np.stack(columns, axis=1) if columns else np.zeros((len(residual), 0))
    u, s, _ = np.linalg.svd(x * weights[:, None], full_matrices=False)
    u = u[:, s > 1e-8 * s.max(initial=1e-300)]
    left = residual - u @ (u.T @ (residual * weights)) / weights
    return np.asarray(left), np.asarray((u**2).sum(1))
