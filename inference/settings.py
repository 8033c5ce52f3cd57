"""What a user states about clips, and how many are worked on at once."""

from __future__ import annotations

import math
import os
from typing import Annotated

from pydantic import ValidationInfo, field_validator

from physconvex import InputError
from physconvex.io import CommandLine, Options

_UNITS = {"fps": "1/s", "density": "kg/m³", "object_size": "m"}


class StatedConditions(Options):
    """What the user states about clips; None leaves it to the clip's own data, then to the default."""

    fps: float | None = None
    """Frames per second of the motion [1/s]. Default: the file's."""
    density: float | None = None
    """Density [kg/m³]. Default: the capture's, else 1000."""
    object_size: float | None = None
    """Largest edge of the object at rest [m]. Default: the capture's mesh, else 1."""

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
    """Clips read at once. Default: 2, or 1 on a single core."""
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
