"""What noise and numerical error lead one to expect, anew where a fit has led far from the base fit.

Meshes, steps and contacts part by what they do to the body that is simulated. Where an effect had moved E of the base
fit by a decade, they part there by four times what they do at the body's own E, and so hide a second effect.
"""

from __future__ import annotations

from physconvex.gap.base.model import MODULUS
from physconvex.gap.errors.numerics import Numerics, error_model, numerical_differences
from physconvex.gap.search.hypothesis import continued, weighed_anew
from physconvex.gap.search.search_state import FAILURES, EffectSearch
from physconvex.gap.search.space_mapping import confirmed
from physconvex.gap.thresholds import RUN_COST, SEARCH

__all__ = ["expect_anew"]


def expect_anew(search: EffectSearch) -> Numerics | None:
    """Weigh the fits of a free body by the differences at the best one, if its E is far from the base fit's.

    Args:
        search: its errors and fits are changed, and what it may cost.

    Returns:
        Those at the best fit; None, and nothing is changed, where E has not moved or no model can be run there.
    """
    base, best = search.full, search.best
    names = base.model.base
    if base.situation.clamped or MODULUS not in names or not best.effects or search.late:
        return None
    place = names.index(MODULUS)
    if abs(best.values[place] - base.fit.values[place]) <= SEARCH.far_modulus:
        return None
    search.report(f"what is expected, at {best.label}")
    cost = base.model.cost
    before = cost.spent
    try:
        point = continued(base, confirmed(base, search.errors, best))
    except FAILURES:
        return None
    numerics = numerical_differences(point, search.options, search.report)
    search.errors = error_model(point, numerics, search.options)
    search.found = [weighed_anew(search.base, search.errors, h) for h in search.found]
    cost.limit += cost.spent - before + RUN_COST.after_moving * search.options.search_cost
    return numerics
