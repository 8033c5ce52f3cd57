"""The commands `physconvex train`, `pretrain`, `calibrate`, `train-segmenter` and `train-outline`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from physconvex.io import command
from train.options import Pretraining
from train.progress import ProgressBar

Data = Annotated[list[Path], typer.Option(help="Data set of `physconvex generate`; may be given several times.")]
RunFolder = Annotated[Path, typer.Option(help="Run folder; its `best/` is the checkpoint.")]
CheckpointFolder = Annotated[Path, typer.Option(help="Folder of the checkpoint.")]
Cache = Annotated[Path | None, typer.Option(help="Where prepared clips live; OUT/cache unless given.")]
Minutes = Annotated[float | None, typer.Option(help="Stop after this time, the learning rate falling with it.")]
Resume = Annotated[bool, typer.Option(help="Go on with the run in --out.")]
Steps = Annotated[int | None, typer.Option(help="Optimiser steps.", min=1)]
Seed = Annotated[int, typer.Option(help="Seed of everything random.", min=0)]
Threads = Annotated[int | None, typer.Option(help="CPU threads of the network.", min=1)]


def train_command(
    *,
    data: Data,
    out: RunFolder,
    config: Annotated[str | None, typer.Option(help="YAML file or preset (`default`).")] = None,
    epochs: Annotated[int | None, typer.Option(help="Epochs.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of everything random.")] = None,
    checkpoint: Annotated[
        str | None, typer.Option(help="Go on from this checkpoint: a folder, or a bundled one's name (`default`).")
    ] = None,
    device: Annotated[str, typer.Option(help="`auto` (an accelerator if there is one) or `cpu`.")] = "auto",
    resume: Resume = True,
    minutes: Minutes = None,
    cache: Cache = None,
    threads: Annotated[int | None, typer.Option(help="CPU threads of the network.")] = None,
) -> None:
    """Train the predictor on data sets made by `physconvex generate`.

    Several processes: `torchrun --nproc_per_node=N -m physconvex train …`.
    """
    import torch

    from physconvex import InputError
    from train.config import load_train_config
    from train.loop import train_predictor

    if device not in ("auto", "cpu"):
        raise InputError(f"device: got {device!r}; expected auto or cpu (choose a GPU with CUDA_VISIBLE_DEVICES)")
    if threads is not None:
        torch.set_num_threads(threads)
    settings = load_train_config(config, epochs=epochs, seed=seed, checkpoint=checkpoint)
    with ProgressBar() as bar:
        result = train_predictor(
            settings, data, out, cpu=device == "cpu", resume=resume, minutes=minutes, cache=cache, report=bar.report
        )
    score = "none" if result.best_score is None else f"{result.best_score:.3f}"
    typer.echo(f"{result.steps} steps, best validation score {score}, checkpoint in {result.checkpoint}")


@command
def pretrain_command(
    *,
    falls: Annotated[Path, typer.Option(help="Folder of `physconvex generate falls`.")],
    data: Data,
    out: RunFolder,
    config: Annotated[str, typer.Option(help="YAML file or preset.")] = "falls",
    plan: Pretraining,
    device: Annotated[str, typer.Option(help="A CUDA device, or `cpu`, which is some hundred times slower.")] = "cuda",
    seed: Seed = 0,
    resume: Resume = True,
    cache: Cache = None,
    workers: Annotated[int, typer.Option(help="Processes that prepare clips and bodies.", min=1)] = 2,
) -> None:
    """Train the predictor on falls simulated and drawn on a GPU, beside data sets."""
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
    """Fit a checkpoint's 90 % intervals anew to the validation clips of data sets, each counted alike."""
    from train.recalibration import recalibrate

    with ProgressBar() as bar:
        result = recalibrate(data, out, checkpoint=checkpoint, cache=cache, workers=workers, report=bar.report)
    for folder, stiffness, poisson in zip(result.data, result.stiffness, result.poisson_ratio, strict=True):
        typer.echo(
            f"{folder}: {stiffness.clips} clips; the intervals cover {stiffness.coverage:.1%} (log10 E, mean width "
            f"{stiffness.width:.2f}) and {poisson.coverage:.1%} (Poisson's ratio, {poisson.width:.3f})"
        )


def train_segmenter_command(
    *,
    data: Data,
    out: CheckpointFolder,
    steps: Steps = None,
    seed: Seed = 0,
    threads: Threads = None,
) -> None:
    """Train the network that finds the object in a clip on the true masks of data sets."""
    import torch

    from train.segmentation import SegmentationConfig, train_segmenter

    if threads is not None:
        torch.set_num_threads(threads)
    config = SegmentationConfig(seed=seed) if steps is None else SegmentationConfig(seed=seed, steps=steps)
    with ProgressBar() as bar:
        result = train_segmenter(config, data, out, report=bar.report)
    typer.echo(f"mean intersection over union on validation clips {result.overlap:.3f}, checkpoint in {out}")


def train_outline_command(
    *,
    data: Data,
    out: CheckpointFolder,
    steps: Steps = None,
    thinning: Annotated[int, typer.Option(help="Use every so many-th training clip.", min=1)] = 1,
    seed: Seed = 0,
    threads: Threads = None,
) -> None:
    """Train the network that corrects the outline that the segmenter finds."""
    import torch

    from train.outline import OutlineTraining, train_outline

    if threads is not None:
        torch.set_num_threads(threads)
    recipe = OutlineTraining(seed=seed, thinning=thinning)
    if steps is not None:
        recipe = replace(recipe, steps=steps)
    with ProgressBar() as bar:
        result = train_outline(recipe, data, out, report=bar.report)
    typer.echo(
        f"mean intersection over union on validation clips {result.overlap:.3f}, of the rough silhouettes "
        f"{result.rough_overlap:.3f}, checkpoint in {out}"
    )
