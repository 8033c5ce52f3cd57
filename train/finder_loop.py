"""Training of the finder's two networks, and the measure of their silhouettes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
import torch
from jaxtyping import Bool
from timm.utils import ModelEmaV3
from torch import Tensor, nn

import physconvex
from models import OutlineConfig, SegmenterConfig, save_network
from train.progress import Report
from train.records import LabelledClip, Split, data_listing, read_clips
from train.segmentation_data import SegmentationAugmentation

Network = TypeVar("Network", bound=nn.Module)
Clip = TypeVar("Clip")


@dataclass(frozen=True, kw_only=True)
class FinderRecipe:
    """Common part of both recipes."""

    network: SegmenterConfig | OutlineConfig
    steps: int
    """Steps of the optimiser."""
    batch: int
    """Clips per step."""
    learning_rate: float
    """Largest."""
    weight_decay: float = 1e-4
    """Of AdamW."""
    average: float
    """Decay of the running average of the weights, which is the result."""
    thinning: int = 1
    """Every so many-th training clip is used."""
    start: Path | None = None
    """Checkpoint to go on from, of the same network; random weights unless given."""
    augmentation: SegmentationAugmentation = field(default_factory=SegmentationAugmentation)
    seed: int = 0
    """Of everything random."""


@dataclass(frozen=True)
class FinderResult:
    """How a training ended."""

    losses: tuple[float, ...]
    """Of every step."""
    metrics: dict[str, float]
    """On validation clips; `intersection_over_union` of the silhouettes with the truth, a mean (0..1)."""


class FinderTask(Protocol[Network, Clip]):
    """What one of the two networks learns, and from which clips."""

    def read(self, clips: Sequence[LabelledClip], progress: Callable[[int], None]) -> list[Clip]:
        """The clips, as they are kept in memory; calls `progress` with the number read."""

    def network(self) -> Network:
        """The network to start from."""

    def loss(self, network: Network, clip: Clip, generator: np.random.Generator) -> Tensor:
        """Of one clip, changed at random."""

    def metrics(self, network: Network, clips: Sequence[Clip]) -> dict[str, float]:
        """Of the trained network."""


def train_finder(
    task: FinderTask[Network, Clip],
    recipe: FinderRecipe,
    data: Sequence[Path | str],
    out: Path | str,
    card: str,
    *,
    report: Report | None = None,
) -> FinderResult:
    """Train on the `train` split, measure on `validation`, write a checkpoint into `out`.

    Random numbers depend only on the seed. `report` is called with a name of the work, the number done, the total. The
    model card is a format of `recipe`, `data`, `begun`, the numbers of clips `train` and `validation`, and the metrics.

    Raises:
        InputError: a folder is no data set, or has no clip in one of the two splits.
    """
    say: Report = report or (lambda name, done, total: None)
    listed: dict[Split, list[LabelledClip]] = {
        "train": read_clips(data, "train")[:: recipe.thinning],
        "validation": read_clips(data, "validation"),
    }

    def read(split: Split) -> list[Clip]:
        clips = listed[split]
        return task.read(clips, lambda done: say(f"reading {split} clips", done, len(clips)))

    training, validation = read("train"), read("validation")
    network, losses = _averaged(task, recipe, training, say)
    metrics = task.metrics(network, validation)
    begun = "from random weights" if recipe.start is None else "from the weights of an earlier training"
    counts = {split: len(clips) for split, clips in listed.items()}
    model_card = card.format(recipe=recipe, data=data_listing(data), begun=begun, **counts, **metrics)
    stored = recipe.network.model_copy(update={"version": physconvex.__version__, "metrics": metrics})
    save_network(out, network, stored, model_card=model_card)
    return FinderResult(tuple(losses), metrics)


def _averaged(
    task: FinderTask[Network, Clip], recipe: FinderRecipe, clips: Sequence[Clip], report: Report
) -> tuple[Network, list[float]]:
    """The averaged network in evaluation mode, and the loss of every step."""
    with torch.random.fork_rng():
        torch.manual_seed(recipe.seed)
        network = task.network()
    network = network.to(memory_format=torch.channels_last)
    average = ModelEmaV3(network, decay=recipe.average, use_warmup=True)
    optimizer = torch.optim.AdamW(network.parameters(), lr=recipe.learning_rate, weight_decay=recipe.weight_decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, recipe.learning_rate, total_steps=recipe.steps, pct_start=0.1
    )
    losses = []
    for step in range(recipe.steps):
        optimizer.zero_grad()
        generator, total = np.random.default_rng((recipe.seed, step)), 0.0
        for index in generator.integers(0, len(clips), recipe.batch):
            share = task.loss(network, clips[index], generator) / recipe.batch
            share.backward()
            total += float(share.detach())
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        average.update(network, step=step)
        losses.append(total)
        report(f"training, loss {np.mean(losses[-50:]):.3f}", step + 1, recipe.steps)
    trained = average.module
    assert isinstance(trained, type(network))
    return trained.eval(), losses


def overlap_of_frames(found: Bool[np.ndarray, "T H W"], true: Bool[np.ndarray, "T H W"]) -> float:
    """Intersection over union, mean over the frames in which either shows the object."""
    union = (found | true).sum(axis=(1, 2))
    return float(np.mean((found & true).sum(axis=(1, 2))[union > 0] / union[union > 0]))
