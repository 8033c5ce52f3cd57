"""The best network as a checkpoint for `predict`, with its model card."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from models import ClipConfig, PhysicsNetwork, PhysicsPredictor, PredictorConfig, TrainingRange, find_checkpoint
from train.data import TrainingClips
from train.records import data_listing
from train.validation import DensityMetrics, Validation


@dataclass(frozen=True)
class Origin:
    """Training data of a network."""

    data: Sequence[Path | str]
    """Data sets."""
    checkpoint: str | None = None
    """The checkpoint that its training went on from."""
    share: float | None = None
    """Share of the trained weights in the mixture with that checkpoint's; None: no mixture."""
    beside: str = ""
    """What else it saw, in words."""


def export_best(
    folder: Path,
    network: PhysicsNetwork,
    *,
    clips: TrainingClips,
    settings: ClipConfig,
    validation: Validation,
    origin: Origin,
) -> None:
    """Write network, calibration, ranges and metrics for `PhysicsPredictor.from_pretrained`."""
    calibration = validation.calibration()
    stiffness, poisson = metrics = validation.metrics(calibration)
    labels = {name: getattr(clips, name) for name in ("log10_stiffness", "poisson_ratio", "interval")}
    ranges = TrainingRange(**{name: (float(of.min()), float(of.max())) for name, of in labels.items()})
    config = PredictorConfig(
        network=network.config,
        clip=settings,
        calibration=calibration,
        training_range=ranges,
        metrics={
            "log10_youngs_modulus_mae": stiffness.mae,
            "poisson_ratio_mae": poisson.mae,
            "skinning_span_missed": validation.span,
            "skinning_energy_missed": validation.captured,
        },
    )
    card = _model_card(validation, metrics, ranges, clips=len(clips), origin=origin)
    PhysicsPredictor(network, config).save_pretrained(folder, model_card=card)


def _model_card(
    validation: Validation,
    metrics: tuple[DensityMetrics, DensityMetrics],
    ranges: TrainingRange,
    *,
    clips: int,
    origin: Origin,
) -> str:
    """Markdown: training data, accuracy and limits of the network."""
    stiffness, poisson = metrics
    low, high = ranges.log10_stiffness
    earlier = "" if origin.checkpoint is None else _earlier_training(origin.checkpoint, origin.share)
    also = f"\n{origin.beside}\n" if origin.beside else ""
    return f"""# physconvex predictor

Reads a clip of one soft object that falls on a floor; says Young's modulus, Poisson's ratio and skinning weights.

## Training data

{clips} clips, simulated by the finite-element code of this project and rendered, from

{data_listing(origin.data)}
{also}{earlier}
log10(E / (ρ g L)) from {low:.2f} to {high:.2f}; ν from {ranges.poisson_ratio[0]:.2f} to {ranges.poisson_ratio[1]:.2f};
frame interval {ranges.interval[0]:.3f} to {ranges.interval[1]:.3f} √(L/g).

## Validation ({stiffness.clips} clips of objects that are not in the training data; also used to choose and calibrate)

| | mean absolute error | constant predictor | 90 % interval covers | its mean width |
|---|---|---|---|---|
| log10 E | {stiffness.mae:.3f} | {stiffness.constant_mae:.3f} | {stiffness.coverage:.1%} | {stiffness.width:.2f} |
| ν | {poisson.mae:.4f} | {poisson.constant_mae:.4f} | {poisson.coverage:.1%} | {poisson.width:.3f} |

Skinning weights miss {validation.captured:.1%} of the motion beyond the affine and {validation.span:.1%} of the
eigenmodes.

## Limits

One homogeneous object, dropped on a rigid floor under g = 9.81 m/s², seen by a camera that stands still. E in pascals
rests on the density, object size and frame rate that are given. Other scenes (several objects, being pushed, pulled,
hung up) are not in the training data, and the intervals do not cover what such scenes change.
"""


def _earlier_training(checkpoint: str, share: float | None) -> str:
    """Statement of the starting point's model card on its own clips."""
    folder = find_checkpoint(checkpoint)
    checksum = hashlib.sha256((folder / "model.safetensors").read_bytes()).hexdigest()
    said = (folder / "model_card.md").read_text(encoding="utf-8").partition("## Training data\n")[2]
    quoted = "\n".join(f"> {line}".rstrip() for line in said.partition("\n## ")[0].strip().splitlines())
    taken = (
        "" if share is None else f" Its weights are {share:.0%} of the way from that one's to those trained further."
    )
    return f"""
It went on from the checkpoint `{folder.name}`, SHA-256 `{checksum}`.{taken} That one's card says of its training:

{quoted or "> nothing"}
"""
