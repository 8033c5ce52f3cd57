"""Two models of one twin: the reduced one searches, the full-order one decides (space mapping).

A reduced run costs a tenth of a full-order one. What the two differ by at one set of values is added to the reduced
model, which is then searched; a full-order run at what was found gives the next difference, and so on, until the values
stay. The residual is thus always the full-order model's, the derivatives are the reduced model's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.gap.baseline import Baseline
from physconvex.gap.comparison import Hypothesis, hypothesis_at, refit
from physconvex.gap.model import reduced_like
from physconvex.gap.options import GapOptions
from physconvex.gap.score import ErrorModel

__all__ = ["as_reduced", "confirmed"]

_ROUNDS = 2  # of full-order run and search
_STILL = 0.02  # of typical steps: a change of the values below which another round is not worth it


def as_reduced(base: Baseline) -> Baseline:
    """The baseline with the reduced model in the place of the full-order one; it says the same at the fit."""
    model, motion = reduced_like(base.model, base.motion, base.fit.values)
    return replace(base, model=model, motion=motion)


def confirmed(base: Baseline, errors: ErrorModel, found: Hypothesis, options: GapOptions) -> Hypothesis:
    """A fit of the reduced model, carried over to the full-order one.

    Args:
        base: the full-order base fit.
        errors: weights of the residuals.
        found: what the reduced model came to.
        options: settings.

    Raises:
        ConvergenceError: the full-order model cannot be run there.
    """
    full = replace(base.model, effects=found.model.effects)
    scales = np.array([p.step for p in full.parameters(found.values)])
    best, values, last = None, found.values, found
    for number in range(_ROUNDS + 1):
        try:
            motion = full.motion(values)
        except ConvergenceError:
            if best is None:
                raise
            break
        here = hypothesis_at(base, errors, full, values, last.errors, motion, last.tangents)
        if best is None or here.fitted < best.fitted:
            best = here
        if number == _ROUNDS or here.fitted > 1.5 * best.fitted:
            break
        model, _ = reduced_like(full, motion, values)
        try:
            last = refit(base, errors, model, values, last.tangents, options)
        except ConvergenceError:
            break
        if np.abs((last.values - values) / scales).max() < _STILL:
            break
        values = last.values
    assert best is not None
    return best
