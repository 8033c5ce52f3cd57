"""Evaluate a checkpoint on held-out objects, the diagnosis on sealed captures, everything on the benchmark."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from train.blind.command import app as gap_app
from train.paper.command import paper_command
from train.progress import ProgressBar

__all__ = ["app"]

app = typer.Typer(no_args_is_help=True, help=__doc__)
app.add_typer(gap_app, name="gap")
app.command("paper")(paper_command)

Data = Annotated[list[Path], typer.Option(help="Data set of `physconvex generate`; may be given several times.")]
Out = Annotated[Path, typer.Option(help="Folder of the results (JSON and figure).")]
Checkpoint = Annotated[str, typer.Option(help="Name or folder of a checkpoint.")]
Split = Annotated[
    Literal["train", "validation", "test", "all"],
    typer.Option(help="Which objects; `all` of a data set that nothing was trained on."),
]
Cache = Annotated[Path | None, typer.Option(help="Where prepared clips live; OUT/cache unless given.")]
Limit = Annotated[int | None, typer.Option(help="At most this many clips.")]
Device = Annotated[str, typer.Option(help="Device of the network.")]
Seed = Annotated[int, typer.Option(help="Of shuffled times and random bases.")]
Workers = Annotated[int, typer.Option(help="Processes that prepare clips.")]
TrainingData = Annotated[
    list[Path] | None, typer.Option(help="Whose training clips' median the constant predictor says; DATA unless given.")
]


@app.command()
def predictor(
    *,
    data: Data,
    out: Out,
    checkpoint: Checkpoint = "default",
    split: Split = "test",
    cache: Cache = None,
    limit: Limit = None,
    device: Device = "cpu",
    seed: Seed = 0,
    workers: Workers = 1,
    training_data: TrainingData = None,
) -> None:
    """Errors of log10 E and ν and coverage of their intervals, by decade of stiffness.

    Beside the constant predictor, and the same network given frames in random order, and a single frame.
    """
    from train.predictor_evaluation import evaluate_predictor, write_predictor_report

    with ProgressBar() as bar:
        result = evaluate_predictor(
            data, checkpoint=checkpoint, split=split, cache=cache or out / "cache", limit=limit, device=device,
            seed=seed, workers=workers, training_data=training_data,
            report=bar.report,
        )  # fmt: skip
    write_predictor_report(out, result)
    typer.echo(result.table())


@app.command()
def skinning(
    *,
    data: Data,
    out: Out,
    checkpoint: Checkpoint = "default",
    split: Split = "test",
    cache: Cache = None,
    limit: Limit = None,
    device: Device = "cpu",
    seed: Seed = 0,
    workers: Workers = 1,
) -> None:
    """Share of FEM motion that the predicted handles follow, beside eigenmodes and a random basis."""
    from train.skinning_evaluation import evaluate_skinning, write_skinning_report

    with ProgressBar() as bar:
        result = evaluate_skinning(
            data, checkpoint=checkpoint, split=split, cache=cache or out / "cache", limit=limit, device=device,
            seed=seed, workers=workers, report=bar.report,
        )  # fmt: skip
    write_skinning_report(out, result)
    typer.echo(result.table())
