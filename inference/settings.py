"""What a user states about clips, how many are worked on at once, and what a reconstruction is to do."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated

from pydantic import ValidationInfo, field_validator

from physconvex import InputError
from physconvex.io import CommandLine, Options
from physconvex.reconstruction import ReconstructionConfig, load_reconstruction_config

_UNITS = {"fps": "1/s", "density": "kg/m³", "object_size": "m"}


class StatedConditions(Options):
    """What the user states about clips; None leaves it to the clip's own data, then to the default."""

    fps: float | None = None
    """Frames per second of the motion [1/s]. Default: those of the file."""
    density: float | None = None
    """Density [kg/m³]. Default: that of the capture, else 1000."""
    object_size: float | None = None
    """Longest edge of the object at rest [m]. Default: that of the mesh of the capture, else 1."""

    @field_validator(*_UNITS, mode="before")
    @classmethod
    def _positive(cls, value: object, info: ValidationInfo) -> object:
        if value is not None and not _is_positive(value):
            name = info.field_name
            assert name is not None
            raise InputError(
                f"{name} is {value!r}; expected a positive, finite number [{_UNITS[name]}]. "
                f"Give the measured value, or leave {name} out to use the default."
            )
        return value


def _is_positive(value: object) -> bool:
    import numpy as np

    is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    return is_number and math.isfinite(value) and value > 0  # type: ignore[arg-type,operator]


class BatchOptions(Options):
    """How the work is done; none of it changes a prediction."""

    batch_size: int = 8
    """Most clips in one pass of the network."""
    workers: int | None = None
    """Number of clips read at once. Default: 2, or 1 on a single core."""
    processes: Annotated[bool, CommandLine(hidden=True)] = True
    """Read in worker processes, so that a codec that crashes takes one clip with it; else in threads."""

    @field_validator("batch_size", "workers", mode="before")
    @classmethod
    def _count(cls, value: object, info: ValidationInfo) -> object:
        if value is not None and (not isinstance(value, int) or value < 1):
            raise InputError(f"{info.field_name} is {value!r}; expected a whole number of at least 1.")
        return value

    @property
    def readers(self) -> int:
        """Number of clips read at once."""
        return self.workers or min(2, os.cpu_count() or 1)


class ReconstructOptions(Options):
    """Settings of `reconstruct`. `settings` override `config`; `start`, `budget`, `steps` and `seed` override both."""

    held_out: Annotated[tuple[str, ...], CommandLine("--held-out")] = ()
    """Camera that is scored and not fitted; repeatable."""
    config: Path | ReconstructionConfig | None = None
    """YAML file of settings."""
    settings: Annotated[tuple[str, ...], CommandLine("--set")] = ()
    """Change a setting, such as budget=12000 or point_rate=0.1; repeatable."""
    start: str | None = None
    """Source of the first convexes: mesh, hull, points, or auto (mesh, else points, else hull)."""
    points: Path | None = None
    """File whose vertices are the points for --start points [m]."""
    budget: int | None = None
    """Most convexes. Default: 16000."""
    steps: int | None = None
    """Steps of the optimiser; each uses one view. Default: 200."""
    seed: int | None = None
    """Seed of everything random."""
    device: str = "cpu"
    """Torch device of rendering and fit, such as cpu or cuda."""

    @property
    def resolved(self) -> ReconstructionConfig:
        """The configuration of the fit.

        Raises:
            InputError: see `load_reconstruction_config`.
        """
        return load_reconstruction_config(
            self.config, overrides=self.settings, start=self.start, budget=self.budget, steps=self.steps, seed=self.seed
        )
