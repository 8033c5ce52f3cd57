"""The base model fitted to the first frames alone: a second point from which effects are looked for.

Over all frames E and ν absorb what they can of an effect (plastic flow looks like a body a decade softer), and at such
a fit no dose looks right. What an effect does adds up over time, so that the first frames which tell E at all tell it
with less of the effect in it: prediction error in the place of output error, at the price of more noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from physconvex.errors import ConvergenceError
from physconvex.gap.base.baseline import Baseline, Report, derivatives_of_residuals
from physconvex.gap.base.model import MODULUS, SecantModel
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.options import GapOptions
from physconvex.gap.search.effect_fits import derivatives_at
from physconvex.gap.thresholds import SEARCH
from physconvex.identify import FitOptions, fit

__all__ = ["early_point", "early_window"]


def early_window(base: Baseline, errors: ErrorModel) -> int | None:
    """Number of first frames that tell E well enough; None where that takes nearly all of the fitted ones."""
    names = base.model.base
    if MODULUS not in names:
        return None
    count = base.split.end
    lowest = max(6, count // 3) if base.first_contact is None else base.first_contact + 2
    here = base.positions[: len(base.tangents)]
    columns = derivatives_of_residuals(base, here, base.tangents)
    scales = np.array([p.step for p in base.model.parameters(base.fit.values)])[: len(columns)]
    for window in range(lowest, int(SEARCH.early_longest * count) + 1):
        rows = base.rows(np.arange(window))
        whitened = errors.restricted(rows).whiten(columns[:, rows]) * scales[:, None]
        information = whitened @ whitened.T + 1e-8 * np.eye(len(scales))
        index = names.index(MODULUS)
        if np.sqrt(np.linalg.inv(information)[index, index]) * scales[index] < SEARCH.early_told:
            return window
    return None


def early_point(base: Baseline, errors: ErrorModel, options: GapOptions, report: Report) -> Baseline | None:
    """The baseline at the fit of the first frames; None where there is no such window, or it says the same."""
    window = early_window(base, errors)
    if window is None:
        return None
    report("fit of the base model to the first frames")
    shorter, values = replace(base.model, frames=window), base.fit.values
    weighted = base.weighted(errors.variance, window)
    secant = SecantModel(shorter, values, base.positions[:window], base.tangents[:window])
    stop = FitOptions(max_iterations=options.iterations + 3, relative_tolerance=2e-3, absolute_tolerance=0.1)
    try:
        found = fit(secant, weighted, shorter.parameters(values), options=stop)
        index = base.model.base.index(MODULUS)
        if abs(found.values[index] - values[index]) < SEARCH.early_apart:
            return None
        motion = base.model.motion(found.values)
        tangents = derivatives_at(base, base.model, found.values, motion)
    except ConvergenceError:
        return None
    here = replace(base.fit, parameters=base.model.parameters(found.values), values=found.values)
    return replace(base, fit=here, motion=motion, tangents=tangents)
