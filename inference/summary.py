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
    def truncated(self) -> int:
        """Clips of this run that were predicted from the part that is left of a file."""
        return sum(bool(row.truncated) for row in self.rows)

    @property
    def exit_code(self) -> int:
        """0 if every clip has a prediction from its whole file, else 1."""
        return 1 if self.failed or self.truncated else 0
