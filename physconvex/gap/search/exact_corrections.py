"""Fits that are each corrected by the most exact run at their own values, of bodies that strike something.

What a finer mesh and finer steps change is added to every run of a model (`physconvex.gap.errors.numerics`), and is
known at the base fit. An effect turns a rebound elsewhere, where they change something else: with the base fit's, what
the true effects left after an impact was up to four times what they leave with their own, and effects that are wrong
left no more.
"""

from __future__ import annotations

from dataclasses import replace

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.effects.motion import MotionCorrection, PointMotion
from physconvex.gap.errors.numerics import Numerics, exact_model
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.search.hypothesis import Hypothesis, hypothesis_at

__all__ = ["with_own_correction"]


def with_own_correction(base: Baseline, errors: ErrorModel, numerics: Numerics, found: Hypothesis) -> Hypothesis:
    """A full-order fit with what the most exact run at its values changes; as it is where no such run is affordable.

    Args:
        base: the full-order base fit.
        errors: weights of the residuals.
        numerics: what the most exact run is made on.
        found: the fit, by the full-order model.

    Raises:
        ConvergenceError: the body cannot be simulated so, or the runs have cost what they may.
    """
    if numerics.exact is None:
        return found
    base.model.cost.check()
    exact = exact_model(found.model, numerics.exact[0])
    run = exact.motion(found.values)
    if run.steps is not None and found.motion.steps is not None:
        steps = PointMotion.of_steps(
            run.steps, len(found.motion.steps.times), exact.refinement // found.model.refinement
        )
        run = replace(run, steps=replace(steps, steps=None))
    model = replace(found.model, correction=MotionCorrection.between(run, found.motion))
    return hypothesis_at(base, errors, model, found.values, found.errors, found.motion, found.tangents)
