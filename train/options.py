"""What a training on falls and both evaluations of a checkpoint are asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from physconvex.io import CommandLine, Options

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


class Pretraining(Options):
    """How a training on falls goes, besides what `TrainConfig` says."""

    steps: Annotated[int, Field(ge=1)] = 3700
    """Of the optimiser."""
    minutes: float | None = None
    """Stop after this time, the learning rate falling with it."""
    drawn: Annotated[int, Field(ge=1)] = 168
    """Falls of each step."""
    real: Annotated[int, Field(ge=1)] = 24
    """Clips of data sets of each step."""
    real_weight: Annotated[float, CommandLine(hidden=True)] = 0.5
    """Of what is said of their material, which few simulations can teach by heart; not of their states."""
    report_steps: Annotated[int, CommandLine(hidden=True)] = 200
    """Between two scores, which are also the states that a run can go on from."""
