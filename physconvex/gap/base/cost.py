"""What model runs cost, counted and not timed: a search ends at the same fit on a busy machine and an idle one.

A Newton step costs the more the more its material does: damping has a stiffness of its own, laws other than the base
one have no fast arithmetic, and flow and the corotated law take the stretches of every sample. A deadline by the clock
stands behind the count, for machines so slow or so busy that the count would mean a report too late.
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
    """A fit ends where it is: its runs have cost what they may."""


def newton_step(scene: Any, nodes: int | None) -> float:
    """About what one Newton step of a scene costs [s of one core].

    Args:
        scene: full-order or reduced.
        nodes: of the full-order mesh, None for the reduced model.
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
    """Sum over runs, shared by all models that are derived from one, and what they may cost.

    Attributes:
        deadline: seconds after which the whole diagnosis ought to be through.
        spent: about so many seconds of one core.
        limit: of `spent`, from which on no step of a fit is begun.
        share: of the deadline, from which on the same holds.
        begun: by the clock [s].
        cut: whether the clock has ended something.
        hurried: whether it did so before each effect that screening ranks first had been tried; set by the search.
    """

    deadline: float = float("inf")
    spent: float = 0.0
    limit: float = float("inf")
    share: float = 1.0
    begun: float = field(default_factory=time.monotonic)
    cut: bool = False
    hurried: bool = False

    def allow(self, budget: float, share: float) -> None:
        """From here on so much more may be spent, up to a share of the deadline."""
        self.limit, self.share = self.spent + budget, share

    @contextmanager
    def at_most(self, budget: float) -> Iterator[None]:
        """For what is run inside, so much and no more than what is left."""
        before = self.limit
        self.limit = min(before, self.spent + budget)
        try:
            yield
        finally:
            self.limit = before

    @property
    def out_of_time(self) -> bool:
        """Whether the clock ends what is done."""
        late = time.monotonic() - self.begun > self.share * self.deadline
        self.cut |= late
        return late

    @property
    def over(self) -> bool:
        """Whether no further step of a fit is to begin."""
        return self.out_of_time or self.spent > self.limit

    def check(self) -> None:
        """End a fit in progress.

        Raises:
            OutOfBudget: no further step is to begin.
        """
        if self.over:
            raise OutOfBudget("the runs have cost what they may")

    def add(self, scene: Any, nodes: int | None, statistics: SolveStatistics) -> None:
        """A run of the full-order model on so many nodes, or of the reduced one (None)."""
        self.spent += statistics.newton_iterations * newton_step(scene, nodes)

    def add_failed(self, scene: Any, nodes: int | None, steps: int) -> None:
        """A run that was given up, of so many time steps."""
        self.spent += RUN_COST.failed * steps * newton_step(scene, nodes)
