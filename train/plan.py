"""Which clips each step sees: a function of the seed, so that a run can go on at any step."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Int64

from physconvex.errors import InputError
from train.config import TrainConfig

__all__ = ["Plan", "Step"]


@dataclass(frozen=True)
class Step:
    """One update."""

    epoch: int
    """Counted over both phases."""
    clips: list[int]
    video: bool
    ends_epoch: bool
    position: int
    """Within its phase."""
    phase_steps: int


@dataclass(frozen=True)
class Plan:
    """First `kinematics_epochs` without video, then `epochs` with it; the last incomplete batch is left out."""

    clips: int
    kinematics_epochs: int
    kinematics_batch_size: int
    epochs: int
    batch_size: int
    seed: int

    @classmethod
    def of(cls, config: TrainConfig, clips: int, *, world: int = 1) -> Plan:
        """The plan of a configuration.

        Raises:
            InputError: the batch cannot be shared among the processes, or there are too few clips.
        """
        sizes = (min(config.kinematics_batch_size, clips), min(config.batch_size, clips))
        if any(size % world for size in sizes):
            raise InputError(
                f"batch_size: {sizes} are no multiples of {world} processes; change them in the configuration"
            )
        return cls(clips, config.kinematics_epochs, sizes[0], config.epochs, sizes[1], config.seed)

    @property
    def kinematics_steps(self) -> int:
        """Of the first phase."""
        return self.kinematics_epochs * (self.clips // self.kinematics_batch_size)

    @property
    def steps(self) -> int:
        """Of both phases."""
        return self.kinematics_steps + self.epochs * (self.clips // self.batch_size)

    def step(self, number: int) -> Step:
        """What happens in step `number`."""
        video = number >= self.kinematics_steps
        size = self.batch_size if video else self.kinematics_batch_size
        position = number - self.kinematics_steps if video else number
        per_epoch = self.clips // size
        epoch, place = divmod(position, per_epoch)
        epoch += self.kinematics_epochs if video else 0
        chosen = _permutation(self.seed, epoch, self.clips)[place * size : (place + 1) * size]
        return Step(
            epoch=epoch,
            clips=chosen.tolist(),
            video=video,
            ends_epoch=place == per_epoch - 1,
            position=position,
            phase_steps=self.steps - self.kinematics_steps if video else self.kinematics_steps,
        )


@lru_cache(maxsize=4)
def _permutation(seed: int, epoch: int, count: int) -> Int64[np.ndarray, " N"]:
    return np.random.default_rng([seed, epoch]).permutation(count)
