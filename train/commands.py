"""The commands `physconvex train`, `pretrain`, `calibrate`, `train-segmenter` and `train-outline`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from physconvex.io import command
from train.options import FinderOptions, OutlineOptions, Pretraining, TrainOptions
from train.progress import ProgressBar

Data = Annotated[list[Path], typer.Option(help="Data set of `physconvex generate`; repeatable.")]
RunFolder = Annotated[Path, typer.Option(help="Folder of the run; its subfolder `best` is the checkpoint.")]
CheckpointFolder = Annotated[Path, typer.Option(help="Folder of the checkpoint.")]
Cache = Annotated[Path | None, typer.Option(help="Folder of prepared clips. Default: OUT/cache.")]


@command
def train_command(*, data: Data, out: RunFolder, options: TrainOptions) -> None:
    """Train the predictor on data sets made by `physconvex generate`.

    For several processes: `torchrun --nproc_per_node=N -m physconvex train …`.
    """
    from train.config import load_train_config
    from train.loop import train_predictor

    _use_threads(options.threads)
    config = load_train_config(options.config, epochs=options.epochs, seed=options.seed, checkpoint=options.checkpoint)
    with ProgressBar() as bar:
        result = train_predictor(
            config, data, out, cpu=options.device == "cpu", resume=options.resume, minutes=options.minutes,
            cache=options.cache, report=bar.report,
        )  # fmt: skip
    score = "none" if result.best_score is None else f"{result.best_score:.3f}"
    typer.echo(f"{result.steps} steps, best validation score {score}, checkpoint in {result.checkpoint}")


def _use_threads(count: int | None) -> None:
    """On the CPU, by the network."""
    import torch

    if count is not None:
        torch.set_num_threads(count)


@command
def pretrain_command(
    *,
    falls: Annotated[Path, typer.Option(help="Folder of `physconvex generate falls`.")],
    data: Data,
    out: RunFolder,
    config: Annotated[str, typer.Option(help="YAML file or preset.")] = "falls",
    plan: Pretraining,
    device: Annotated[str, typer.Option(help="CUDA device, or `cpu` (some hundred times slower).")] = "cuda",
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0)] = 0,
    resume: Annotated[bool, typer.Option(help="Continue the run in OUT.")] = True,
    cache: Cache = None,
    workers: Annotated[int, typer.Option(help="Processes that prepare clips and bodies.", min=1)] = 2,
) -> None:
    """Train the predictor on falls that a GPU simulates and renders, together with data sets."""
    from train.config import load_train_config
    from train.falls.run import train_on_falls

    with ProgressBar() as bar:
        checkpoint = train_on_falls(
            load_train_config(config, seed=seed), plan, falls, data, out,
            device=device, cache=cache, workers=workers, resume=resume, report=bar.report,
        )  # fmt: skip
    typer.echo(f"checkpoint in {checkpoint}")


def calibrate_command(
    *,
    data: Data,
    out: Annotated[Path, typer.Option(help="Folder of the calibrated checkpoint.")],
    checkpoint: Annotated[str, typer.Option(help="Name or folder of the checkpoint.")] = "default",
    cache: Cache = None,
    workers: Annotated[int, typer.Option(help="Processes that prepare clips.", min=1)] = 1,
) -> None:
    """Refit the 90 % intervals of a checkpoint to validation clips, with equal weight for each data set."""
    from train.recalibration import recalibrate

    with ProgressBar() as bar:
        result = recalibrate(data, out, checkpoint=checkpoint, cache=cache, workers=workers, report=bar.report)
    for folder, stiffness, poisson in zip(result.data, result.stiffness, result.poisson_ratio, strict=True):
        typer.echo(
            f"{folder}: {stiffness.clips} clips; the intervals cover {stiffness.coverage:.1%} (log10 E, mean width "
            f"{stiffness.width:.2f}) and {poisson.coverage:.1%} (Poisson's ratio, {poisson.width:.3f})"
        )


@command
def train_segmenter_command(*, data: Data, out: CheckpointFolder, options: FinderOptions) -> None:
    """Train the network that finds the object in a clip, on the true masks of data sets."""
    from train.segmentation import SegmentationConfig, train_segmenter

    _use_threads(options.threads)
    recipe = SegmentationConfig(**options.model_dump(exclude_none=True, exclude={"threads"}))
    with ProgressBar() as bar:
        metrics = train_segmenter(recipe, data, out, report=bar.report).metrics
    overlap = metrics["intersection_over_union"]
    typer.echo(f"mean intersection over union on validation clips {overlap:.3f}, checkpoint in {out}")


@command
def train_outline_command(*, data: Data, out: CheckpointFolder, options: OutlineOptions) -> None:
    """Train the network that corrects the outlines of the segmenter."""
    from train.outline import OutlineTraining, train_outline

    _use_threads(options.threads)
    recipe = OutlineTraining(**options.model_dump(exclude_none=True, exclude={"threads"}))
    with ProgressBar() as bar:
        metrics = train_outline(recipe, data, out, report=bar.report).metrics
    typer.echo(
        f"mean intersection over union on validation clips {metrics['intersection_over_union']:.3f}, of the rough "
        f"silhouettes {metrics['before']:.3f}, checkpoint in {out}"
    )
