"""What model runs cost, counted and not timed: a search ends at the same fit on a busy machine and an idle one."""

from __future__ import annotations

from dataclasses import dataclass

from physconvex.fem import SolveStatistics

__all__ = ["Cost"]

# seconds of one core, measured on boxes of 200 to 1500 nodes: one Newton step of the full-order model by node, and of
# the reduced one with what a fit does around it
_FULL, _REDUCED = 8e-6, 5e-4
_FAILED = 4  # Newton steps by time step that a run which did not converge counts as


@dataclass(eq=False)
class Cost:
    """Sum over runs, shared by all models that are derived from one.

    Attributes:
        spent: about so many seconds of one core.
    """

    spent: float = 0.0

    def add(self, statistics: SolveStatistics, nodes: int | None) -> None:
        """A run of the full-order model on so many nodes, or of the reduced one (None)."""
        self._count(statistics.newton_iterations, nodes)

    def add_failed(self, steps: int, nodes: int | None) -> None:
        """A run that was given up, of so many time steps."""
        self._count(_FAILED * steps, nodes)

    def _count(self, iterations: int, nodes: int | None) -> None:
        self.spent += iterations * (_REDUCED if nodes is None else _FULL * nodes)
