"""Batches of augmented clips with their targets; every draw depends only on seed, epoch and clip.

The clips of each step are a function of the seed, so that a run can continue at any step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
import torch
from jaxtyping import Float32, Int64
from torch.utils.data import DataLoader, Dataset, Sampler

from models import ClipBatch, dimensionless_interval, log10_dimensionless_stiffness
from physconvex import InputError
from train.augment import Sample, augment
from train.cache import PreparedClips, prepare_clips
from train.config import AugmentConfig, TrainConfig
from train.losses import Targets
from train.motion_states import referred_states
from train.records import ClipSamples, LabelledClip, read_clips

_POINTS, _FRAMES = 256, 8  # of the samples of a simulation, drawn anew each time
_Example = dict[str, np.ndarray]  # one clip: fields of `ClipBatch` and `Targets`
_Stack = TypeVar("_Stack", ClipBatch, Targets)


@dataclass(frozen=True)
class Item:
    """One clip of one batch."""

    epoch: int
    clip: int


@dataclass(frozen=True, eq=False)
class TrainingBatch:
    """Clips and their targets."""

    clips: ClipBatch
    targets: Targets


class TrainingClips(Dataset[_Example]):
    """Augmented clips (or, with `augmentation` None, clips as they are)."""

    def __init__(
        self,
        clips: Sequence[LabelledClip],
        prepared: PreparedClips,
        *,
        augmentation: AugmentConfig | None,
        modes: int,
        seed: int,
    ) -> None:
        self.prepared, self._augmentation, self._modes, self._seed = prepared, augmentation, modes, seed
        self._samples = [clip.samples for clip in clips]
        self.states = [_shown_states(clip, prepared, k) for k, clip in enumerate(clips)]
        size = np.array([clip.object_size for clip in clips])
        modulus = np.array([clip.youngs_modulus for clip in clips])
        density = np.array([clip.density for clip in clips])
        self.log10_stiffness = log10_dimensionless_stiffness(modulus, density=density, object_size=size)
        self.poisson_ratio = np.array([clip.poisson_ratio for clip in clips])
        self.interval = dimensionless_interval(prepared.fps.astype(np.float64), object_size=size)

    def __len__(self) -> int:
        return len(self._samples)

    def __getitem__(self, item: Item) -> _Example:
        generator = np.random.default_rng([self._seed, item.epoch, item.clip])
        k, config = item.clip, self._augmentation
        samples = self._subsampled(self._samples[k], generator)
        true_moments = config is not None and generator.random() < config.true_moments_share
        sample = Sample(
            windows=np.asarray(self.prepared.windows[k]),
            moments=np.asarray(self.prepared.moments[k, int(true_moments)]),
            valid=np.asarray(self.prepared.valid[k]),
            interval=float(self.interval[k]),
            points=samples.points,
            states=self.states[k],
        )
        if config is not None:
            sample = augment(sample, config, generator)
        shown = np.sort(generator.permutation(len(samples.displacements))[:_FRAMES])
        motion = np.moveaxis(samples.displacements[shown], 0, 1).reshape(len(samples.points), -1)
        labels = {"log10_stiffness": self.log10_stiffness[k], "poisson_ratio": self.poisson_ratio[k]}
        numbers = labels | {"interval": sample.interval, "confidence": self.prepared.confidence[k]}
        targets = {name: getattr(samples, name) for name in ("modes", "importance", "volume_weights")}
        scalars = {name: np.float32(value) for name, value in numbers.items()}
        return vars(sample) | targets | scalars | {"displacements": motion}

    def _subsampled(self, samples: ClipSamples, generator: np.random.Generator) -> ClipSamples:
        chosen = np.sort(generator.permutation(len(samples.points))[:_POINTS])
        return replace(
            samples,
            points=samples.points[chosen],
            volume_weights=samples.volume_weights[chosen],
            displacements=samples.displacements[:, chosen],
            modes=samples.modes[chosen, : self._modes],
            importance=samples.importance[: self._modes],
        )


def _shown_states(clip: LabelledClip, prepared: PreparedClips, index: int) -> Float32[np.ndarray, "T S"]:
    """True states of the frames that a prepared clip shows."""
    states = clip.samples.states()
    times = prepared.start_time[index] + np.arange(prepared.valid.shape[1]) / prepared.fps[index]
    last = int(prepared.valid[index].sum()) - 1
    shown = np.clip(np.rint(times * clip.fps).astype(int), 0, len(states) - 1)
    return referred_states(states[shown[np.minimum(np.arange(len(shown)), last)]])


def collate(examples: Sequence[_Example]) -> TrainingBatch:
    """Stack."""
    return TrainingBatch(_stacked(ClipBatch, examples), _stacked(Targets, examples))


def _stacked(kind: type[_Stack], examples: Sequence[Mapping[str, np.ndarray]]) -> _Stack:
    names = kind.__dataclass_fields__
    return kind(**{name: torch.from_numpy(np.stack([example[name] for example in examples])) for name in names})


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


class _Schedule(Sampler[list[Item]]):
    """One process's share of each batch of the plan."""

    def __init__(self, plan: Plan, first_step: int, rank: int, world: int) -> None:
        self._plan, self._steps, self._share = plan, range(first_step, plan.steps), slice(rank, None, world)

    def __len__(self) -> int:
        return len(self._steps)

    def __iter__(self) -> Iterator[list[Item]]:
        for step in map(self._plan.step, self._steps):
            yield [Item(step.epoch, clip) for clip in step.clips[self._share]]


def batches(
    clips: TrainingClips, plan: Plan, *, first_step: int, rank: int = 0, world: int = 1, workers: int = 0
) -> Iterator[TrainingBatch]:
    """The batches of the plan from `first_step` on; each process gets its share of each batch."""
    context = "spawn" if workers else None
    loader = DataLoader(
        clips,
        batch_sampler=_Schedule(plan, first_step, rank, world),
        collate_fn=collate,
        num_workers=workers,
        multiprocessing_context=context,
        prefetch_factor=4 if workers else None,
    )
    return iter(loader)


def split_clips(
    split: Literal["train", "validation"],
    config: TrainConfig,
    data: Sequence[Path | str],
    cache: Path,
    *,
    workers: int,
    report: Callable[[str, int, int], None],
) -> TrainingClips:
    """The clips of one split of data sets, prepared for a recipe.

    Those for training are augmented, some with their true masks; those for validation are as at inference.

    Args:
        split: which objects.
        config: the recipe.
        data: data-set folders.
        cache: where prepared clips live.
        workers: processes that prepare them; 0 does so in this one.
        report: called with a name of the work, the number done and the total.

    Raises:
        InputError: bad data, or no clip in the split.
    """
    clips, training = read_clips(data, split), split == "train"
    prepared = prepare_clips(
        clips,
        config.clip,
        cache,
        true_mask_share=config.true_mask_share if training else 0.0,
        workers=workers,
        progress=lambda done, total: report(f"preparing {split} clips", done, total),
    )
    return TrainingClips(
        clips,
        prepared,
        augmentation=config.augment if training else None,
        modes=config.loss.modes,
        seed=config.seed,
    )
