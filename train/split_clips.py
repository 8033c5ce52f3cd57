"""The clips of one split of some data sets, prepared for a recipe."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from train.cache import prepare_clips
from train.config import TrainConfig
from train.data import TrainingClips
from train.records import read_clips


def split_clips(
    split: Literal["train", "validation"],
    config: TrainConfig,
    data: Sequence[Path | str],
    cache: Path,
    *,
    workers: int,
    report: Callable[[str, int, int], None],
) -> TrainingClips:
    """For training, augmented and some with their true masks, or for validation, as at inference.

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
