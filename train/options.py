"""Options of the commands that train and evaluate a checkpoint."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator

from physconvex import InputError
from physconvex.io import CommandLine, Options

Shown = Literal["train", "validation", "test", "all"]


class TrainOptions(Options):
    """Settings of a training of the predictor on data sets."""

    config: str | None = None
    """YAML file or preset (`default`)."""
    epochs: int | None = None
    """Passes over the training clips."""
    seed: int | None = None
    """Seed of everything random."""
    checkpoint: str | None = None
    """Start from this checkpoint: a folder, or the bundled one (`default`)."""
    device: str = "auto"
    """`auto` (an accelerator if there is one) or `cpu`."""
    resume: bool = True
    """Continue the run in OUT."""
    minutes: float | None = None
    """Stop after this time [min]; the learning-rate schedule fits it."""
    cache: Path | None = None
    """Folder of prepared clips. Default: OUT/cache."""
    threads: int | None = None
    """CPU threads of the network."""

    @field_validator("device")
    @classmethod
    def _automatic(cls, device: str) -> str:
        if device not in ("auto", "cpu"):
            raise InputError(f"device: got {device!r}; expected auto or cpu (choose a GPU with CUDA_VISIBLE_DEVICES)")
        return device


class FinderOptions(Options):
    """Settings of a training of one network of the finder; None takes the default of its recipe."""

    steps: Annotated[int | None, Field(ge=1), CommandLine(bounded=True)] = None
    """Steps of the optimiser."""
    seed: Annotated[int, Field(ge=0), CommandLine(bounded=True)] = 0
    """Seed of everything random."""
    threads: Annotated[int | None, Field(ge=1), CommandLine(bounded=True)] = None
    """CPU threads of the network."""


class OutlineOptions(FinderOptions):
    """Settings of a training of the outline network."""

    thinning: Annotated[int, Field(ge=1), CommandLine(bounded=True)] = 1
    """Use every N-th training clip."""


class Pretraining(Options):
    """Settings of a training on falls, in addition to `TrainConfig`."""

    steps: Annotated[int, Field(ge=1)] = 3700
    """Steps of the optimiser."""
    minutes: float | None = None
    """Stop after this time [min]; the learning-rate schedule fits it."""
    drawn: Annotated[int, Field(ge=1)] = 168
    """Falls in each step."""
    real: Annotated[int, Field(ge=1)] = 24
    """Clips of data sets in each step."""
    real_weight: Annotated[float, CommandLine(hidden=True)] = 0.5
    """Weight of the material loss of clips of data sets, whose few simulations invite overfitting. The weight of their
    state loss is 1."""
    report_steps: Annotated[int, CommandLine(hidden=True)] = 200
    """Steps between two scores; a run resumes from the last of them."""


class EvaluationOptions(Options):
    """Clips on which a checkpoint is evaluated, and the device."""

    checkpoint: str = "default"
    """Name or folder of a checkpoint."""
    split: Shown = "test"
    """Share of the objects to evaluate; `all` suits a data set that is not used for training."""
    cache: Path | None = None
    """Folder of prepared clips. Default: OUT/cache."""
    limit: int | None = None
    """Most clips to evaluate. Default: all."""
    device: str = "cpu"
    """Torch device of the network, such as cpu or cuda."""
    seed: int = 0
    """Seed of shuffled frames and random bases."""
    workers: int = 1
    """Processes that prepare clips."""


class PaperOptions(Options):
    """Settings of an evaluation on the benchmark."""

    max_nodes: int = 500
    """Most nodes of the quadratic meshes of the models."""
    fine_nodes: int | None = None
    """Most nodes of the mesh of the last fits. Default: that of `refine`."""
    steps_per_frame: int | None = None
    """Time steps per frame of the models. Default: 384 per second."""
    weights: int = 20
    """Number of skinning weights of `refine`."""
    full_runs: int = 8
    """Most linearisations of the full-order model."""
    model_error: bool = True
    """Fit a finer model too; its difference corrects the estimates and widens the intervals."""
    adam_steps: int = 400
    """Steps of Adam in the method of the paper; 0 leaves it and its variants out."""
    adam_scale: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Share of the images' resolution at which the method of the paper compares pixels."""
    ablation: tuple[int, ...] = (8, 10, 12)
    """Number M of skinning weights in the ablation with K = 4 and K = 6; 0 leaves it out; repeatable."""
    ablation_points: Annotated[tuple[int, ...], CommandLine("--points")] = (3, 4, 5, 6, 7, 8)
    """Number K of points per convex in the ablation with M = 10; 0 leaves it out; repeatable."""
    field_budget: int | None = None
    """Most convexes of a convex field. Default: that of `refine`."""
    field_steps: int | None = None
    """Steps of the fit of a convex field. Default: that of `refine`."""
    checkpoint: str = "default"
    """Name or folder of the checkpoint of the network."""

    @field_validator("ablation", "ablation_points")
    @classmethod
    def _some(cls, counts: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(count for count in counts if count)

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """The pairs (K, M) of both ablations, each once."""
        over_weights = [(points, weights) for points in (4, 6) for weights in self.ablation]
        return tuple(sorted({(points, 10) for points in self.ablation_points} | set(over_weights)))
