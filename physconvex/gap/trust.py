"""How much of the numerical error that other meshes lead one to expect is really there: no fit can err by less than it.

What a mesh of 250 nodes and one of 1000 differ by after an impact may be many times what the finer one errs by, and an
effect that is smaller is then lost in it. But the residual of the fitted frames is error and effect together. If the
base model, or it with one effect, leaves a tenth of the expected error, then the error is no larger than that tenth
(unless the two cancel all the time). As in a regression, the scale of the errors comes from the largest model. A margin
keeps what an effect absorbs of numerical error by chance from being called a cause.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from physconvex.gap.baseline import Baseline
from physconvex.gap.score import ErrorModel
from physconvex.gap.screening import Screening

__all__ = ["error_scale"]

_MARGIN = 4.0  # of squares: an effect must remove more than 1 − 1/(1.5 × this) of them to open a gap
_LEAST = 0.15  # scale below which nothing is believed
_FRAMES = 2  # that tell: fitted ones whose numerical error is above noise


def error_scale(base: Baseline, errors: ErrorModel, screening: Screening) -> float:
    """Factor on the numerical error, 0.15 to 1.

    Args:
        base: the base fit.
        errors: with the numerical error as other meshes, steps and contact have it.
        screening: of the effects at that fit; each may explain what it can to first order, numerical ones not.
    """
    rows = base.rows(base.split.fitted)
    numerical = errors.expected[rows] - 1.0
    told = numerical > 1.0
    if len(np.unique(base.observations.frames[rows][told])) < _FRAMES:
        return 1.0
    weights = 1 / np.sqrt(errors.expected[rows])
    count = int(base.split.fitted[-1]) + 1
    here = base.positions[:count]
    tangents = [base.change(here + 1e-3 * d)[rows] / 1e-3 for d in np.moveaxis(base.tangents[:count], 1, 0)]
    residual = base.residual(base.positions)[rows]
    candidates: list[list[np.ndarray]] = [[]]
    for entry in screening.one_per_name:
        if entry.effect.source != "numerical" and np.any(entry.score.amounts):
            signature = np.tensordot(entry.score.amounts, entry.signature, 1)
            candidates.append([base.change(here + signature)[rows]])
    wanted = np.inf
    for columns in candidates:
        left = _left(residual, [*tangents, *columns], weights)
        share = (weights**4 * (left**2 - 1.0))[told].sum() / (weights**4 * numerical)[told].sum()
        wanted = min(wanted, float(share))
    return float(np.clip(np.sqrt(_MARGIN * max(wanted, 0.0)), _LEAST, 1.0))


def _left(
    residual: Float[np.ndarray, " n"], columns: list[np.ndarray], weights: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """What a weighted regression on the columns leaves."""
    x = np.stack(columns, axis=1) if columns else np.zeros((len(residual), 0))
    found = np.linalg.lstsq(x * weights[:, None], residual * weights, rcond=1e-8)[0]
    return np.asarray(residual - x @ found)
