"""State of a search: fits so far, cost so far, and whether to continue."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from physconvex.errors import ConvergenceError, InputError
from physconvex.gap.base.baseline import Baseline, Report
from physconvex.gap.errors.score_test import ErrorModel
from physconvex.gap.errors.screening import Screened
from physconvex.gap.options import GapOptions
from physconvex.gap.search.effect_fits import fit_effects
from physconvex.gap.search.hypothesis import Hypothesis, judged
from physconvex.gap.thresholds import RUN_COST, SEARCH

# from runs with extreme doses; such a fit is left out, and the report says so
FAILURES = (ConvergenceError, InputError, np.linalg.LinAlgError)


@dataclass(eq=False)
class EffectSearch:
    """A search in progress.

    Attributes:
        full: base fit, of the full-order model.
        base: the same of the reduced one.
        errors: weights of the residuals.
        options: settings.
        report: receives progress messages.
        found: fits so far, the base model first.
        polished: ids of the motions of fits that need no refit.
    """

    full: Baseline
    base: Baseline
    errors: ErrorModel
    options: GapOptions
    report: Report
    found: list[Hypothesis] = field(default_factory=list)
    polished: set[int] = field(default_factory=set)

    @property
    def best(self) -> Hypothesis:
        """The best fit by tempered evidence."""
        return self.ranked[0]

    @property
    def ranked(self) -> list[Hypothesis]:
        """Fits so far by tempered evidence, best first."""
        return judged(self.base, self.errors, self.found)

    @property
    def placed(self) -> bool:
        """Whether to try several places and directions of an effect: a struck body shows its deformation."""
        return not self.base.situation.clamped and self.base.positions.shape[1] >= SEARCH.telling_points

    @property
    def late(self) -> bool:
        """Whether the runs so far have used their budget."""
        return self.base.model.cost.over

    def wanting(self, fit: Hypothesis) -> bool:
        """Whether to search for a further effect beside those of a fit."""
        room = len(fit.effects) < self.options.most_effects
        return room and not self.late and self.open(fit)

    def open(self, fit: Hypothesis) -> bool:
        """Whether a fit leaves something to explain.

        The residual of a wide gap is smooth and counts as few independent residuals, but the fit is open. So is one
        whose gap opens in the selecting frames.
        """
        return fit.left_to_explain >= SEARCH.left or fit.fitted > SEARCH.wide or fit.selecting > SEARCH.late

    def attempt(self, text: str, run: Callable[[], Hypothesis]) -> Hypothesis | None:
        """Fit and keep, unless it fails or the budget is used; the first one always begins."""
        if self.late and len(self.found) > 1:
            return None
        self.report(f"fit: {text}")
        try:
            with self.base.model.cost.at_most(RUN_COST.longest_fit * self.options.search_cost):
                hypothesis = run()
        except FAILURES:
            self.report(f"fit: {text} failed")
            return None
        if not np.isfinite(hypothesis.positions).all():
            return None
        self.found.append(hypothesis)
        return hypothesis

    def fit(self, chosen: Sequence[Screened], starts: Baseline | None = None) -> Hypothesis | None:
        """Fit screened effects, beside those of `starts`."""
        kept = () if starts is None else tuple(e.label for e in starts.model.effects)
        text = " + ".join([*kept, *(entry.effect.label for entry in chosen)])
        return self.attempt(text, lambda: fit_effects(self.base, self.errors, chosen, self.options, starts=starts))
