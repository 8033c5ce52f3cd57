"""Clips of each step: a function of the seed, so that a run can continue at any step."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Int64

from physconvex import InputError
from train.config import TrainConfig


@dataclass(frozen=True)
class PlannedStep:
    """One update."""

    epoch: int
    clips: list[int]
    ends_epoch: bool


@dataclass(frozen=True)
class Plan:
    """Every clip once an epoch, but for the last incomplete batch."""

    clips: int
    epochs: int
    batch_size: int
    seed: int

    @classmethod
    def of(cls, config: TrainConfig, clips: int, *, world: int = 1) -> Plan:
        """The plan of a configuration.

        Raises:
            InputError: the batch cannot be divided among the processes, or there are too few clips.
        """
        size = min(config.batch_size, clips)
        if size % world:
            raise InputError(f"batch_size: {size} is no multiple of {world} processes; change it in the configuration")
        return cls(clips, config.epochs, size, config.seed)

    @property
    def steps(self) -> int:
        """Of the whole run."""
        return self.epochs * (self.clips // self.batch_size)

    def step(self, number: int) -> PlannedStep:
        """The clips of step `number`."""
        per_epoch, size = self.clips // self.batch_size, self.batch_size
        epoch, place = divmod(number, per_epoch)
        chosen = _permutation(self.seed, epoch, self.clips)[place * size : (place + 1) * size]
        return PlannedStep(epoch=epoch, clips=chosen.tolist(), ends_epoch=place == per_epoch - 1)


@lru_cache(maxsize=4)
def _permutation(seed: int, epoch: int, count: int) -> Int64[np.ndarray, " N"]:
    return np.random.default_rng([seed, epoch]).permutation(count)
