"""What came of a batch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from inference.table import ResultRow

__all__ = ["BatchSummary"]


@dataclass(frozen=True, kw_only=True)
class BatchSummary:
    """What came of a batch."""

    out: Path
    rows: tuple[ResultRow, ...]
    """The clips of this run, in the order they were found."""
    predicted: int
    """Clips predicted in this run."""
    resumed: int
    """Clips that an earlier run had finished."""
    failed: int
    """Clips without prediction."""

    @property
    def exit_code(self) -> int:
        """0 if every clip has a prediction, else 1."""
        return 1 if self.failed else 0
