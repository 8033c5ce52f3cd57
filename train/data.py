"""Batches of augmented clips with their targets; every draw depends only on seed, epoch and clip."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32
from torch.utils.data import DataLoader, Dataset, Sampler

from models import ClipBatch, dimensionless_interval, log10_dimensionless_stiffness
from train.augment import Sample, augment
from train.cache import PreparedClips
from train.config import AugmentConfig
from train.epoch_plan import Plan
from train.losses import Targets
from train.motion_states import referred_states
from train.records import ClipSamples, LabelledClip

_POINTS, _FRAMES = 256, 8  # of the samples of a simulation, drawn anew each time


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


@dataclass(frozen=True, eq=False)
class _Example:
    sample: Sample
    confidence: float
    log10_stiffness: float
    poisson_ratio: float
    samples: ClipSamples
    displacements: Float32[np.ndarray, "Q N"]


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
        return _Example(
            sample=sample,
            confidence=float(self.prepared.confidence[k]),
            log10_stiffness=float(self.log10_stiffness[k]),
            poisson_ratio=float(self.poisson_ratio[k]),
            samples=samples,
            displacements=motion,
        )

    def _subsampled(self, samples: ClipSamples, generator: np.random.Generator) -> ClipSamples:
        chosen = np.sort(generator.permutation(len(samples.points))[:_POINTS])
        return ClipSamples(
            points=samples.points[chosen],
            volume_weights=samples.volume_weights[chosen],
            displacements=samples.displacements[:, chosen],
            height=samples.height,
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
    samples = [example.sample for example in examples]
    return TrainingBatch(
        clips=ClipBatch(
            windows=torch.from_numpy(np.stack([s.windows for s in samples])),
            moments=torch.from_numpy(np.stack([s.moments for s in samples])),
            valid=torch.from_numpy(np.stack([s.valid for s in samples])),
            interval=torch.tensor([s.interval for s in samples], dtype=torch.float32),
            confidence=torch.tensor([e.confidence for e in examples], dtype=torch.float32),
        ),
        targets=Targets(
            log10_stiffness=torch.tensor([e.log10_stiffness for e in examples], dtype=torch.float32),
            poisson_ratio=torch.tensor([e.poisson_ratio for e in examples], dtype=torch.float32),
            states=torch.from_numpy(np.stack([s.states for s in samples])),
            points=torch.from_numpy(np.stack([s.points for s in samples])),
            modes=torch.from_numpy(np.stack([e.samples.modes for e in examples])),
            importance=torch.from_numpy(np.stack([e.samples.importance for e in examples])),
            volume_weights=torch.from_numpy(np.stack([e.samples.volume_weights for e in examples])),
            displacements=torch.from_numpy(np.stack([e.displacements for e in examples])),
        ),
    )


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
