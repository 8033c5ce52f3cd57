"""What both evaluations of a checkpoint are asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from physconvex.io import Options

Shown = Literal["train", "validation", "test", "all"]


class EvaluationOptions(Options):
    """Which clips of data sets a checkpoint is evaluated on, and where."""

    checkpoint: str = "default"
    """Name or folder of a checkpoint."""
    split: Shown = "test"
    """Which objects; `all` of a data set that nothing was trained on."""
    cache: Path | None = None
    """Where prepared clips live; OUT/cache unless given."""
    limit: int | None = None
    """At most this many clips."""
    device: str = "cpu"
    """Device of the network."""
    seed: int = 0
    """Of shuffled times and random bases."""
    workers: int = 1
    """Processes that prepare clips."""
