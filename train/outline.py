"""Training of the network that corrects a rough silhouette (`models.outline`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

import physconvex
from models import OutlineConfig, OutlineNetwork, load_outline, outline_input, refined_coverage, save_network
from train.finder_loop import FinderRecipe, overlap_of_frames, train_finder_network
from train.outline_data import RoughClip, degraded, read_rough_clips, rearranged
from train.progress import Report
from train.records import Split, data_listing, read_clips
from train.segmentation_data import MaskedClip, recoloured

_LEAST_AREA = 50.0  # [px]; errors count against the object's area and this


@dataclass(frozen=True, kw_only=True)
class OutlineTraining(FinderRecipe):
    """The recipe."""

    steps: int = 3000
    batch: int = 4
    frames: int = 8
    """Of a clip, per step."""
    learning_rate: float = 3e-3
    average: float = 0.995
    thinning: int = 1
    """Every so many-th training clip is used."""
    network: OutlineConfig = field(default_factory=OutlineConfig)


@dataclass(frozen=True)
class OutlineResult:
    """How a training ended."""

    losses: tuple[float, ...]
    """Of every step."""
    rough_overlap: float
    """Mean intersection over union of the rough silhouettes with the truth on validation clips (0..1)."""
    overlap: float
    """The same of the corrected ones."""


def train_outline(
    config: OutlineTraining, data: Sequence[Path | str], out: Path | str, *, report: Report | None = None
) -> OutlineResult:
    """Train on the true masks of the `train` split, measure on `validation`, write a checkpoint into `out`.

    Rough silhouettes are the bundled segmenter's. Random numbers depend only on the seed. `report` is called with a
    name of the work, the number done, the total.

    Raises:
        InputError: a folder is no data set, or has no clip in one of the two splits.
    """
    say: Report = report or (lambda name, done, total: None)
    training, validation = _read(data, "train", config.thinning, say), _read(data, "validation", 1, say)
    network, losses = _train(config, training, say)
    rough = _mean_overlap(validation, lambda clip: clip.coverage)
    overlap = _mean_overlap(validation, lambda clip: refined_coverage(clip.frames, clip.coverage, network=network))
    metrics = {"intersection_over_union": overlap, "before": rough}
    stored = config.network.model_copy(update={"version": physconvex.__version__, "metrics": metrics})
    card = _model_card(config, data, (len(training), len(validation)), metrics)
    save_network(out, network, stored, model_card=card)
    return OutlineResult(losses=tuple(losses), rough_overlap=rough, overlap=overlap)


def _read(data: Sequence[Path | str], split: Split, thinning: int, say: Report) -> list[RoughClip]:
    listed = read_clips(data, split)[::thinning]
    return read_rough_clips(listed, progress=lambda done: say(f"reading {split} clips", done, len(listed)))


def _train(config: OutlineTraining, clips: Sequence[RoughClip], say: Report) -> tuple[OutlineNetwork, list[float]]:
    def build() -> OutlineNetwork:
        return OutlineNetwork(config.network) if config.start is None else load_outline(config.start).train()

    def losses(network: OutlineNetwork, generator: np.random.Generator) -> Iterator[Tensor]:
        for pixels, truth in _examples(clips, config, generator):
            yield outline_loss(network(pixels)[:, : truth.shape[1], : truth.shape[2]], truth)

    return train_finder_network(config, build, losses, say)


def _examples(
    clips: Sequence[RoughClip], config: OutlineTraining, generator: np.random.Generator
) -> Iterator[tuple[Float[Tensor, "T 9 H W"], Bool[Tensor, "T H W"]]]:
    """Input and truth of the clips of one step."""
    for index in generator.integers(0, len(clips), config.batch):
        clip = degraded(rearranged(clips[index], config.augmentation, generator), generator)
        coloured = recoloured(MaskedClip(clip.frames, clip.mask), config.augmentation, generator)
        clip = replace(clip, frames=coloured.frames)
        shown = np.sort(generator.permutation(len(clip.frames))[: config.frames])
        planes = outline_input(clip.frames, clip.coverage, shown=shown)
        yield planes, torch.from_numpy(clip.mask[shown])


def outline_loss(logits: Float[Tensor, "T H W"], truth: Bool[Tensor, "T H W"]) -> Float[Tensor, ""]:
    """Cross entropy over the object's area, 1 - Dice (Milletari et al. 2016), and the error of the area."""
    target = truth.to(logits.dtype)
    area = target.sum(dim=(1, 2))
    entropy = functional.binary_cross_entropy_with_logits(logits, target, reduction="none").sum(dim=(1, 2))
    probability = logits.sigmoid()
    found = probability.sum(dim=(1, 2))
    dice = (2 * (probability * target).sum(dim=(1, 2)) + 1) / (found + area + 1)
    return ((3 * entropy + (found - area).abs()) / (area + _LEAST_AREA) + 1 - dice).mean()


def _mean_overlap(clips: Sequence[RoughClip], find: Callable[[RoughClip], np.ndarray]) -> float:
    """Intersection over union, mean over frames in which the object is seen."""
    return float(np.mean([overlap_of_frames(find(clip) > 0.5, clip.mask) for clip in clips]))


def _model_card(
    config: OutlineTraining, data: Sequence[Path | str], counts: tuple[int, int], metrics: dict[str, float]
) -> str:
    begun = "from random weights" if config.start is None else "from the weights of an earlier training"
    return f"""# physconvex outline

Corrects the rough silhouette of a moving object by the background that the object uncovers.

## Training data

Rough silhouettes of the bundled segmenter and true masks of {counts[0]} rendered clips, recoloured and disturbed at
random, from

{data_listing(data)}

{config.steps} steps of {config.frames} frames of {config.batch} clips, seed {config.seed}, {begun}.

## Validation

Mean intersection over union with the true masks of {counts[1]} clips of objects that are not in the training data:
{metrics["intersection_over_union"]:.3f}, before the correction {metrics["before"]:.3f}.

## Limits

One object; a camera that stands still but for slight shake. Real videos are not in the training data.
"""
