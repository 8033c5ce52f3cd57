"""New 90 % intervals of a checkpoint, fitted to the validation clips of other data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from models import Calibration, PhysicsPredictor, find_checkpoint
from physconvex import InputError
from train.data import TrainingClips
from train.held_out import held_out
from train.progress import Report
from train.records import dataset_checksum
from train.validation import DensityMetrics, calibration_of, validate

_HEADING = "\n## Calibration\n"


@dataclass(frozen=True)
class Recalibration:
    """The fit, and its quality on the clips of each data set."""

    calibration: Calibration
    data: tuple[str, ...]
    stiffness: tuple[DensityMetrics, ...]
    """Of log10(E/(ρ g L)), one per data set."""
    poisson_ratio: tuple[DensityMetrics, ...]


def recalibrate(
    data: Sequence[Path | str],
    out: Path,
    *,
    checkpoint: str = "default",
    cache: Path | None = None,
    workers: int = 1,
    report: Report | None = None,
) -> Recalibration:
    """Write `checkpoint` into `out` with temperatures and intervals fitted to the validation clips of `data`.

    Every data set has the same weight, regardless of its size. The network's weights do not change.

    Raises:
        InputError: a data set has no validation clips, there are fewer than nine in all, or `out` is the checkpoint
            itself.
    """
    source = find_checkpoint(checkpoint)
    if out.resolve() == source.resolve():
        raise InputError(f"out: {out} is the checkpoint that is calibrated; give another folder")
    predictor = PhysicsPredictor.from_pretrained(checkpoint)
    parts = []
    for folder in data:
        clips = held_out(
            [folder], predictor, split="validation", cache=cache or out / "cache", workers=workers, report=report
        )
        handles = predictor.config.network.skinning.handles
        shown = TrainingClips(clips.labels, clips.prepared, augmentation=None, modes=handles, seed=0)
        parts.append(validate(predictor.network, shown))
    calibration = calibration_of(parts)
    result = Recalibration(
        calibration, tuple(map(str, data)), *zip(*(part.metrics(calibration) for part in parts), strict=True)
    )
    config = predictor.config.model_copy(update={"calibration": calibration})
    card = (source / "model_card.md").read_text(encoding="utf-8").partition(_HEADING)[0]
    PhysicsPredictor(predictor.network, config).save_pretrained(out, model_card=card + _section(result, data))
    return result


def _section(result: Recalibration, data: Sequence[Path | str]) -> str:
    """Of the model card."""
    rows = "\n".join(
        f"| `{Path(folder).name}`, manifest SHA-256 `{dataset_checksum(folder)}` | {e.clips} "
        f"| {e.coverage:.1%} | {e.width:.2f} | {nu.coverage:.1%} | {nu.width:.3f} |"
        for folder, e, nu in zip(data, result.stiffness, result.poisson_ratio, strict=True)
    )
    return f"""{_HEADING}
The intervals were fitted anew to the validation clips of these data sets, each counted alike; the coverage and the
width above are of the calibration before.

| data | clips | interval of log10 E covers | its mean width | interval of ν covers | its mean width |
|---|---|---|---|---|---|
{rows}
"""
