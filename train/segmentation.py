"""Training of the network that finds the object in the frames of a clip (`models.segmenter`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

import physconvex
from models import (
    SegmenterConfig,
    SilhouetteSegmenter,
    block_pixels,
    clip_references,
    load_segmenter,
    object_coverage,
    pad_pictures,
    save_network,
)
from train.finder_loop import FinderRecipe, overlap_of_frames, train_finder_network
from train.progress import Report
from train.records import Split, data_listing, read_clips
from train.segmentation_data import MaskedClip, augmented, moving_part, read_masked_clips


@dataclass(frozen=True, kw_only=True)
class SegmentationConfig(FinderRecipe):
    """The recipe."""

    steps: int = 1100
    batch: int = 3
    learning_rate: float = 2e-3
    average: float = 0.99
    network: SegmenterConfig = field(default_factory=SegmenterConfig)


@dataclass(frozen=True)
class SegmentationResult:
    """How a training ended."""

    losses: tuple[float, ...]
    """Of every step."""
    overlap: float
    """Mean intersection over union on validation clips (0..1)."""


def train_segmenter(
    config: SegmentationConfig, data: Sequence[Path | str], out: Path | str, *, report: Report | None = None
) -> SegmentationResult:
    """Train on the true masks of the `train` split, measure on `validation`, write a checkpoint into `out`.

    Random numbers depend only on the seed. `report` is called with a name of the work, the number done, the total.

    Raises:
        InputError: a folder is no data set, or has no clip in one of the two splits.
    """
    say: Report = report or (lambda name, done, total: None)
    training, validation = _read(data, "train", say), _read(data, "validation", say)
    network, losses = _train(config, training, say)
    overlap = mean_overlap(network, validation)
    stored = config.network.model_copy(
        update={"version": physconvex.__version__, "metrics": {"intersection_over_union": overlap}}
    )
    counts = (len(training), len(validation))
    save_network(out, network, stored, model_card=_model_card(config, data, counts, overlap))
    return SegmentationResult(losses=tuple(losses), overlap=overlap)


def _read(data: Sequence[Path | str], split: Split, say: Report) -> list[MaskedClip]:
    listed = read_clips(data, split)
    return read_masked_clips(listed, progress=lambda done: say(f"reading {split} clips", done, len(listed)))


def _train(
    config: SegmentationConfig, clips: Sequence[MaskedClip], say: Report
) -> tuple[SilhouetteSegmenter, list[float]]:
    def build() -> SilhouetteSegmenter:
        return SilhouetteSegmenter(config.network) if config.start is None else load_segmenter(config.start).train()

    def losses(network: SilhouetteSegmenter, generator: np.random.Generator) -> Iterator[Tensor]:
        for index in generator.integers(0, len(clips), config.batch):
            yield _clip_loss(network, augmented(clips[index], config.augmentation, generator))

    return train_finder_network(config, build, losses, say)


def _clip_loss(network: SilhouetteSegmenter, clip: MaskedClip) -> Tensor:
    height, width = clip.mask.shape[1:]
    padded = pad_pictures(clip.frames)
    logits = network(block_pixels(padded), block_pixels(clip_references(padded)))[:, :height, :width]
    return segmentation_loss(logits, torch.from_numpy(clip.mask))


def segmentation_loss(logits: Float[Tensor, "T H W"], truth: Bool[Tensor, "T H W"]) -> Tensor:
    """Cross entropy of the pixels plus 1 - Dice of each frame (Milletari et al. 2016, "V-Net"), averaged."""
    target = truth.to(logits.dtype)
    entropy = functional.binary_cross_entropy_with_logits(logits, target)
    probability = logits.sigmoid()
    shared = (probability * target).sum(dim=(1, 2))
    dice = (2 * shared + 1) / (probability.sum(dim=(1, 2)) + target.sum(dim=(1, 2)) + 1)
    return 3 * entropy + 1 - dice.mean()


def mean_overlap(network: SilhouetteSegmenter, clips: Sequence[MaskedClip]) -> float:
    """Intersection over union in the moving part of each clip, mean over frames in which the object is seen."""
    values = []
    for clip in clips:
        part = moving_part(clip)
        values.append(overlap_of_frames(object_coverage(part.frames, segmenter=network) > 0.5, part.mask))
    return float(np.mean(values))


def _model_card(config: SegmentationConfig, data: Sequence[Path | str], counts: tuple[int, int], overlap: float) -> str:
    begun = "from random weights" if config.start is None else "from the weights of an earlier training"
    return f"""# physconvex segmenter

Says which pixels of each frame show the one object that moves before a camera that stands still.

## Training data

True masks of {counts[0]} rendered clips, recoloured, cut and thinned at random, from

{data_listing(data)}

{config.steps} steps of {config.batch} clips, seed {config.seed}, {begun}.

## Validation

Mean intersection over union with the true masks of {counts[1]} clips of objects that are not in the training data:
{overlap:.3f}.

## Limits

One object; a camera that stands still but for slight shake. What never moves is background. Real videos are not in the
training data.
"""
