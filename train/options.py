"""What the commands that train and the evaluations of a checkpoint are asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator

from physconvex import InputError
from physconvex.io import CommandLine, Options

Shown = Literal["train", "validation", "test", "all"]


class TrainOptions(Options):
    """A training of the predictor on data sets."""

    config: str | None = None
    """YAML file or preset (`default`)."""
    epochs: int | None = None
    """Epochs."""
    seed: int | None = None
    """Seed of everything random."""
    checkpoint: str | None = None
    """Go on from this checkpoint: a folder, or a bundled one's name (`default`)."""
    device: str = "auto"
    """`auto` (an accelerator if there is one) or `cpu`."""
    resume: bool = True
    """Go on with the run in --out."""
    minutes: float | None = None
    """Stop after this time, the learning rate falling with it."""
    cache: Path | None = None
    """Where prepared clips live; OUT/cache unless given."""
    threads: int | None = None
    """CPU threads of the network."""

    @field_validator("device")
    @classmethod
    def _automatic(cls, device: str) -> str:
        if device not in ("auto", "cpu"):
            raise InputError(f"device: got {device!r}; expected auto or cpu (choose a GPU with CUDA_VISIBLE_DEVICES)")
        return device


class FinderOptions(Options):
    """A training of one of the finder's networks; what is None is as in its recipe."""

    steps: Annotated[int | None, Field(ge=1), CommandLine(bounded=True)] = None
    """Optimiser steps."""
    seed: Annotated[int, Field(ge=0), CommandLine(bounded=True)] = 0
    """Seed of everything random."""
    threads: Annotated[int | None, Field(ge=1), CommandLine(bounded=True)] = None
    """CPU threads of the network."""


class OutlineOptions(FinderOptions):
    """A training of the outline network."""

    thinning: Annotated[int, Field(ge=1), CommandLine(bounded=True)] = 1
    """Use every so many-th training clip."""


class Pretraining(Options):
    """How a training on falls goes, besides what `TrainConfig` says."""

    steps: Annotated[int, Field(ge=1)] = 3700
    """Of the optimiser."""
    minutes: float | None = None
    """Stop after this time, the learning rate falling with it."""
    drawn: Annotated[int, Field(ge=1)] = 168
    """Falls of each step."""
    real: Annotated[int, Field(ge=1)] = 24
    """Clips of data sets of each step."""
    real_weight: Annotated[float, CommandLine(hidden=True)] = 0.5
    """Of what is said of their material, which few simulations can teach by heart; not of their states."""
    report_steps: Annotated[int, CommandLine(hidden=True)] = 200
    """Between two scores, which are also the states that a run can go on from."""


class EvaluationOptions(Options):
    """Which clips of data sets a checkpoint is evaluated on, and where."""

    checkpoint: str = "default"
    """Name or folder of a checkpoint."""
    split: Shown = "test"
    """Which objects; `all` of a data set that nothing was trained on."""
    cache: Path | None = None
    """Where prepared clips live; OUT/cache unless given."""
    limit: int | None = None
    """At most this many clips."""
    device: str = "cpu"
    """Device of the network."""
    seed: int = 0
    """Of shuffled times and random bases."""
    workers: int = 1
    """Processes that prepare clips."""


class PaperOptions(Options):
    """Sizes of an evaluation on the benchmark."""

    max_nodes: int = 500
    """Most nodes of the models' quadratic meshes."""
    fine_nodes: int | None = None
    """Most nodes of the mesh of refine's last searches; default: as it has them."""
    steps_per_frame: int | None = None
    """Of the models. Default: 384 per second."""
    weights: int = 20
    """Skinning weights of `refine`."""
    full_runs: int = 8
    """Most linearisations of the full model."""
    model_error: bool = True
    """Add what a finer mesh says."""
    adam_steps: int = 400
    """Of the published way; 0 leaves it out."""
    ablation: tuple[int, ...] = (8, 10, 12)
    """Weights M of the reduced model alone; repeatable."""
    ablation_points: Annotated[tuple[int, ...], CommandLine("--points")] = (4, 5, 6, 7, 8)
    """Points K per convex of further fields, of a quarter of the convexes, scored in the refined motion and in those of
    the ablation over M; repeatable; 0: none."""
    field_budget: int = 24_000
    """Most convexes of a field."""
    field_steps: int = 400
    """Steps of a field's fit."""
    checkpoint: str = "default"
    """Name or folder of the network's checkpoint."""

    @field_validator("ablation_points")
    @classmethod
    def _some(cls, counts: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(count for count in counts if count)
