"""Training of the network that corrects a rough silhouette (`models.outline`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from models import OutlineConfig, OutlineNetwork, load_outline, outline_input, refined_coverage
from train.finder_loop import FinderRecipe, FinderResult, overlap_of_frames, train_finder
from train.outline_data import RoughClip, degraded, read_rough_clips
from train.progress import Report
from train.records import LabelledClip
from train.segmentation_data import rearranged, recoloured, resized

_LEAST_AREA = 50.0  # [px]; errors count against the object's area and this
_CARD = """# physconvex outline

Corrects the rough silhouette of a moving object by the background that the object uncovers.

## Training data

Rough silhouettes of the bundled segmenter and true masks of {train} rendered clips, recoloured and disturbed at
random, from

{data}

{recipe.steps} steps of {recipe.frames} frames of {recipe.batch} clips, seed {recipe.seed}, {begun}.

## Validation

Mean intersection over union with the true masks of {validation} clips of objects that are not in the training data:
{intersection_over_union:.3f}, before the correction {before:.3f}.

## Limits

One object; a camera that stands still but for slight shake. Real videos are not in the training data.
"""


@dataclass(frozen=True, kw_only=True)
class OutlineTraining(FinderRecipe):
    """The recipe."""

    steps: int = 3000
    batch: int = 4
    frames: int = 8
    """Of a clip, per step."""
    learning_rate: float = 3e-3
    average: float = 0.995
    network: OutlineConfig = field(default_factory=OutlineConfig)


def train_outline(
    config: OutlineTraining, data: Sequence[Path | str], out: Path | str, *, report: Report | None = None
) -> FinderResult:
    """Train on the bundled segmenter's silhouettes and true masks, see `train.finder_loop.train_finder`.

    Of its metrics, `before` is the intersection over union of the rough silhouettes.
    """
    return train_finder(_Outline(config), config, data, out, _CARD, report=report)


@dataclass(frozen=True)
class _Outline:
    config: OutlineTraining

    def read(self, clips: Sequence[LabelledClip], progress: Callable[[int], None]) -> list[RoughClip]:
        return read_rough_clips(clips, progress=progress)

    def network(self) -> OutlineNetwork:
        start = self.config.start
        return OutlineNetwork(self.config.network) if start is None else load_outline(start).train()

    def loss(self, network: OutlineNetwork, clip: RoughClip, generator: np.random.Generator) -> Tensor:
        options = self.config.augmentation
        clip = degraded(resized(rearranged(clip, options, generator), options, generator), generator)
        clip = recoloured(clip, options, generator)
        shown = np.sort(generator.permutation(len(clip.frames))[: self.config.frames])
        truth = torch.from_numpy(clip.mask[shown])
        logits = network(outline_input(clip.frames, clip.coverage, shown=shown))
        return outline_loss(logits[:, : truth.shape[1], : truth.shape[2]], truth)

    def metrics(self, network: OutlineNetwork, clips: Sequence[RoughClip]) -> dict[str, float]:
        """Intersection over union, mean over frames in which the object is seen."""

        def mean(find: Callable[[RoughClip], np.ndarray]) -> float:
            return float(np.mean([overlap_of_frames(find(clip) > 0.5, clip.mask) for clip in clips]))

        return {
            "intersection_over_union": mean(lambda clip: refined_coverage(clip.frames, clip.coverage, network=network)),
            "before": mean(lambda clip: clip.coverage),
        }


def outline_loss(logits: Float[Tensor, "T H W"], truth: Bool[Tensor, "T H W"]) -> Float[Tensor, ""]:
    """Cross entropy over the object's area, 1 - Dice (Milletari et al. 2016), and the error of the area."""
    target = truth.to(logits.dtype)
    area = target.sum(dim=(1, 2))
    entropy = functional.binary_cross_entropy_with_logits(logits, target, reduction="none").sum(dim=(1, 2))
    probability = logits.sigmoid()
    found = probability.sum(dim=(1, 2))
    dice = (2 * (probability * target).sum(dim=(1, 2)) + 1) / (found + area + 1)
    return ((3 * entropy + (found - area).abs()) / (area + _LEAST_AREA) + 1 - dice).mean()
