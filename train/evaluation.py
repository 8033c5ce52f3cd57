"""Evaluate the predictor, its skinning weights, the diagnosis, and the benchmark of the paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from physconvex.io import command
from train.blind.command import app as gap_app
from train.options import EvaluationOptions
from train.paper.command import paper_command
from train.progress import ProgressBar

app = typer.Typer(no_args_is_help=True, add_completion=False, help=__doc__)
app.add_typer(gap_app, name="gap")
app.command("paper")(paper_command)

Data = Annotated[list[Path], typer.Option(help="Data set of `physconvex generate`; repeatable.")]
Out = Annotated[Path, typer.Option(help="Folder of the results (JSON and figure).")]
TrainingData = Annotated[
    list[Path] | None,
    typer.Option(help="Data set whose training median is the constant predictor; repeatable. Default: DATA."),
]


@app.command("predictor")
@command
def predictor_command(
    *,
    data: Data,
    out: Out,
    options: EvaluationOptions,
    training_data: TrainingData = None,
) -> None:
    """Print errors of log10 E and ν and the coverage of their intervals, by decade of E.

    Baselines: a constant predictor, and the same network with shuffled frames or a single frame.
    """
    from train.predictor_evaluation import evaluate_predictor, write_predictor_report

    with ProgressBar() as bar:
        result = evaluate_predictor(data, options, out=out, training_data=training_data, report=bar.report)
    write_predictor_report(out, result)
    typer.echo(result.table())


@app.command("skinning")
@command
def skinning_command(
    *,
    data: Data,
    out: Out,
    options: EvaluationOptions,
) -> None:
    """Print the share of the FEM motion that the predicted weights capture. Baselines: eigenmodes and a random
    basis."""
    from train.skinning_evaluation import evaluate_skinning, write_skinning_report

    with ProgressBar() as bar:
        result = evaluate_skinning(data, options, out=out, report=bar.report)
    write_skinning_report(out, result)
    typer.echo(result.table())
