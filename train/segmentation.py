"""Training of the network that finds the object in the frames of a clip (`models.segmenter`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from models import (
    SegmenterConfig,
    SilhouetteSegmenter,
    block_pixels,
    clip_references,
    load_segmenter,
    object_coverage,
    pad_pictures,
)
from train.finder_loop import FinderRecipe, FinderResult, overlap_of_frames, train_finder
from train.progress import Report
from train.records import LabelledClip
from train.segmentation_data import MaskedClip, augmented, moving_part, read_masked_clips

_CARD = """# physconvex segmenter

Says which pixels of each frame show the one object that moves before a camera that stands still.

## Training data

True masks of {train} rendered clips, recoloured, cut and thinned at random, from

{data}

{recipe.steps} steps of {recipe.batch} clips, seed {recipe.seed}, {begun}.

## Validation

Mean intersection over union with the true masks of {validation} clips of objects that are not in the training data:
{intersection_over_union:.3f}.

## Limits

One object; a camera that stands still but for slight shake. What never moves is background. Real videos are not in the
training data.
"""


@dataclass(frozen=True, kw_only=True)
class SegmentationConfig(FinderRecipe):
    """The recipe."""

    steps: int = 1100
    batch: int = 3
    learning_rate: float = 2e-3
    average: float = 0.99
    network: SegmenterConfig = field(default_factory=SegmenterConfig)


def train_segmenter(
    config: SegmentationConfig, data: Sequence[Path | str], out: Path | str, *, report: Report | None = None
) -> FinderResult:
    """Train on the true masks of data sets, see `train.finder_loop.train_finder`."""
    return train_finder(_Segmentation(config), config, data, out, _CARD, report=report)


@dataclass(frozen=True)
class _Segmentation:
    config: SegmentationConfig

    def read(self, clips: Sequence[LabelledClip], progress: Callable[[int], None]) -> list[MaskedClip]:
        return read_masked_clips(clips, progress=progress)

    def network(self) -> SilhouetteSegmenter:
        start = self.config.start
        return SilhouetteSegmenter(self.config.network) if start is None else load_segmenter(start).train()

    def loss(self, network: SilhouetteSegmenter, clip: MaskedClip, generator: np.random.Generator) -> Tensor:
        clip = augmented(clip, self.config.augmentation, generator)
        height, width = clip.mask.shape[1:]
        padded = pad_pictures(clip.frames)
        logits = network(block_pixels(padded), block_pixels(clip_references(padded)))[:, :height, :width]
        return segmentation_loss(logits, torch.from_numpy(clip.mask))

    def metrics(self, network: SilhouetteSegmenter, clips: Sequence[MaskedClip]) -> dict[str, float]:
        """Intersection over union in the moving part of each clip, mean over frames in which the object is seen."""
        values = []
        for part in map(moving_part, clips):
            values.append(overlap_of_frames(object_coverage(part.frames, segmenter=network) > 0.5, part.mask))
        return {"intersection_over_union": float(np.mean(values))}


def segmentation_loss(logits: Float[Tensor, "T H W"], truth: Bool[Tensor, "T H W"]) -> Tensor:
    """Cross entropy of the pixels plus 1 - Dice of each frame (Milletari et al. 2016, "V-Net"), averaged."""
    target = truth.to(logits.dtype)
    entropy = functional.binary_cross_entropy_with_logits(logits, target)
    probability = logits.sigmoid()
    shared = (probability * target).sum(dim=(1, 2))
    dice = (2 * shared + 1) / (probability.sum(dim=(1, 2)) + target.sum(dim=(1, 2)) + 1)
    return 3 * entropy + 1 - dice.mean()
