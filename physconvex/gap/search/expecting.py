"""What noise and numerical error lead one to expect, anew where a fit has led far from the base fit.

Meshes, steps and contacts part by what they do to the body that is simulated. Where an effect had moved E of the base
fit by a decade, they part there by four times what they do at the body's own E, and so hide a second effect.
"""

from __future__ import annotations

from physconvex.gap.base.model import MODULUS
from physconvex.gap.errors.numerics import Numerics, error_model, numerical_differences
from physconvex.gap.errors.score import ErrorModel
from physconvex.gap.search.comparison import Hypothesis, continued, hypothesis_at
from physconvex.gap.search.mapping import confirmed
from physconvex.gap.search.state import FAILURES, Selection

__all__ = ["expect_anew"]

_FAR = 0.5  # decades of E
_AGAIN = 0.5  # of the cost of a search: what it may cost more, since what is beside the best fit shows only now


def expect_anew(search: Selection, numerics: Numerics) -> Numerics:
    """Weigh the fits of a free body by the differences at the best one, if its E is far from the base fit's.

    Args:
        search: its errors and fits are changed, and what it may cost.
        numerics: the differences at the base fit.

    Returns:
        Those at the best fit, or the given ones where E has not moved or no model can be run there.
    """
    base, best = search.full, search.best
    names = base.model.base
    if base.situation.clamped or MODULUS not in names or not best.effects or search.late:
        return numerics
    place = names.index(MODULUS)
    if abs(best.values[place] - base.fit.values[place]) <= _FAR:
        return numerics
    search.report(f"what is expected, at {best.label}")
    cost = base.model.cost
    before = cost.spent
    try:
        point = continued(base, confirmed(base, search.errors, best))
    except FAILURES:
        return numerics
    numerics = numerical_differences(point, search.options, search.report)
    search.errors = error_model(point, numerics, search.options)
    search.found = [_weighed(search, search.errors, h) for h in search.found]
    cost.limit += cost.spent - before + _AGAIN * search.options.search_cost
    return numerics


def _weighed(search: Selection, errors: ErrorModel, fit: Hypothesis) -> Hypothesis:
    return hypothesis_at(search.base, errors, fit.model, fit.values, fit.errors, fit.motion, fit.tangents)
