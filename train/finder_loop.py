"""Training loop of the finder's two networks, and the measure of their silhouettes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Bool
from timm.utils import ModelEmaV3
from torch import Tensor, nn

from train.progress import Report
from train.segmentation_data import SegmentationAugmentation

_Network = TypeVar("_Network", bound=nn.Module)


@dataclass(frozen=True, kw_only=True)
class FinderRecipe:
    """Common part of both recipes."""

    steps: int
    """Of the optimiser."""
    batch: int
    """Clips per step."""
    learning_rate: float
    """Largest."""
    weight_decay: float = 1e-4
    """Of AdamW."""
    average: float
    """Decay of the running average of the weights, which is the result."""
    start: Path | None = None
    """Checkpoint to go on from, of the same network; random weights unless given."""
    augmentation: SegmentationAugmentation = field(default_factory=SegmentationAugmentation)
    seed: int = 0
    """Of everything random."""


def train_finder_network(
    recipe: FinderRecipe,
    build: Callable[[], _Network],
    losses_of_step: Callable[[_Network, np.random.Generator], Iterable[Tensor]],
    report: Report,
) -> tuple[_Network, list[float]]:
    """The averaged network in evaluation mode, and the loss of every step.

    Args:
        recipe: steps, rates, seed.
        build: the network to start from; drawn from torch's generator, seeded.
        losses_of_step: losses of the clips of one step, one after the other, from the step's generator.
        report: called with a name of the work, the number done, the total.
    """
    with torch.random.fork_rng():
        torch.manual_seed(recipe.seed)
        network = build()
    network = network.to(memory_format=torch.channels_last)
    average = ModelEmaV3(network, decay=recipe.average, use_warmup=True)
    optimizer = torch.optim.AdamW(network.parameters(), lr=recipe.learning_rate, weight_decay=recipe.weight_decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, recipe.learning_rate, total_steps=recipe.steps, pct_start=0.1
    )
    losses = []
    for step in range(recipe.steps):
        optimizer.zero_grad()
        total = 0.0
        for loss in losses_of_step(network, np.random.default_rng((recipe.seed, step))):
            share = loss / recipe.batch
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
