"""Cost of model runs, counted instead of timed: a search ends at the same fit on a busy machine and an idle one.

The cost of a Newton step depends on the material. Damping adds its own stiffness, only the base law has fast
arithmetic, and flow and the corotated law need the stretches of every sample. A clock deadline backs up the count on
machines that are too slow or too busy to report in time.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from physconvex.dynamics import SolveStatistics
from physconvex.errors import ConvergenceError
from physconvex.gap.thresholds import RUN_COST


class OutOfBudget(ConvergenceError):
    """Stops a fit whose runs have used their budget."""


def newton_step(scene: Any, nodes: int | None) -> float:
    """Approximate cost of one Newton step of a scene [s of one core].

    `nodes` is the number of nodes of the full-order mesh, None for the reduced model.
    """
    model, body = int(nodes is None), scene.body
    factor = 1.0
    if scene.damping_time > 0:
        factor += RUN_COST.damping[model]
    if body.flow is not None:
        factor += RUN_COST.other_law[model] + RUN_COST.flow[model]
    elif "corotated" in body.law.name:
        factor += RUN_COST.stretches[model]
    elif body.law.volumetric is None:
        factor += RUN_COST.other_law[model]
    return factor * (RUN_COST.reduced_step if nodes is None else RUN_COST.full_step * nodes)


@dataclass(eq=False)
class Cost:
    """Total cost of runs, shared by all models that are derived from one, and its limits.

    Attributes:
        deadline: target for the whole diagnosis [s].
        spent: approximate cost so far [s of one core].
        limit: value of `spent` from which no step of a fit begins.
        share: share of the deadline from which no step of a fit begins.
        begun: clock time of the start [s].
        cut: whether the clock has ended something.
        hurried: whether the clock ended the search before the trial of each top-ranked effect; set by the search.
    """

    deadline: float = float("inf")
    spent: float = 0.0
    limit: float = float("inf")
    share: float = 1.0
    begun: float = field(default_factory=time.monotonic)
    cut: bool = False
    hurried: bool = False

    def allow(self, budget: float, share: float) -> None:
        """Allow this much more from here on, up to a share of the deadline."""
        self.limit, self.share = self.spent + budget, share

    @contextmanager
    def at_most(self, budget: float) -> Iterator[None]:
        """Limit the runs inside to this much, and to what is left."""
        before = self.limit
        self.limit = min(before, self.spent + budget)
        try:
            yield
        finally:
            self.limit = before

    @property
    def out_of_time(self) -> bool:
        """Whether the clock ends the current work."""
        late = time.monotonic() - self.begun > self.share * self.deadline
        self.cut |= late
        return late

    @property
    def over(self) -> bool:
        """Whether no further step of a fit may begin."""
        return self.out_of_time or self.spent > self.limit

    def check(self) -> None:
        """End a fit in progress.

        Raises:
            OutOfBudget: no further step may begin.
        """
        if self.over:
            raise OutOfBudget("the runs have cost what they may")

    def add(self, scene: Any, nodes: int | None, statistics: SolveStatistics) -> None:
        """Count a run of the full-order model on this many nodes, or of the reduced one (None)."""
        self.spent += statistics.newton_iterations * newton_step(scene, nodes)

    def add_failed(self, scene: Any, nodes: int | None, steps: int) -> None:
        """Count an abandoned run of this many time steps."""
        self.spent += RUN_COST.failed * steps * newton_step(scene, nodes)
