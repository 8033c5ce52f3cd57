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
    encoder: bool
    ends_epoch: bool
    position: int
    """Within its phase."""
    phase_steps: int


@dataclass(frozen=True)
class Plan:
    """First `motion_epochs` without the video encoder, then `epochs` with it; the last incomplete batch is left out."""

    clips: int
    motion_epochs: int
    motion_batch_size: int
    epochs: int
    batch_size: int
    seed: int

    @classmethod
    def of(cls, config: TrainConfig, clips: int, *, world: int = 1) -> Plan:
        """The plan of a configuration.

        Raises:
            InputError: the batch cannot be shared among the processes, or there are too few clips.
        """
        sizes = (min(config.motion_batch_size, clips), min(config.batch_size, clips))
        if any(size % world for size in sizes):
            raise InputError(
                f"batch_size: {sizes} are no multiples of {world} processes; change them in the configuration"
            )
        return cls(clips, config.motion_epochs, sizes[0], config.epochs, sizes[1], config.seed)

    @property
    def motion_steps(self) -> int:
        """Of the first phase."""
        return self.motion_epochs * (self.clips // self.motion_batch_size)

    @property
    def steps(self) -> int:
        """Of both phases."""
        return self.motion_steps + self.epochs * (self.clips // self.batch_size)

    def step(self, number: int) -> Step:
        """What happens in step `number`."""
        encoder = number >= self.motion_steps
        size = self.batch_size if encoder else self.motion_batch_size
        position = number - self.motion_steps if encoder else number
        per_epoch = self.clips // size
        epoch, place = divmod(position, per_epoch)
        epoch += self.motion_epochs if encoder else 0
        chosen = _permutation(self.seed, epoch, self.clips)[place * size : (place + 1) * size]
        return Step(
            epoch=epoch,
            clips=chosen.tolist(),
            encoder=encoder,
            ends_epoch=place == per_epoch - 1,
            position=position,
            phase_steps=self.steps - self.motion_steps if encoder else self.motion_steps,
        )


@lru_cache(maxsize=4)
def _permutation(seed: int, epoch: int, count: int) -> Int64[np.ndarray, " N"]:
    return np.random.default_rng([seed, epoch]).permutation(count)
