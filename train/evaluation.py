"""Evaluate the predictor, its skinning weights, the diagnosis, and the benchmark of the paper."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from physconvex.io import command
from train.blind.command import app as gap_app
from train.options import EvaluationOptions, PaperOptions
from train.progress import ProgressBar

app = typer.Typer(no_args_is_help=True, add_completion=False, help=__doc__)
app.add_typer(gap_app, name="gap")

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


@app.command("paper")
@command
def paper_command(
    *,
    benchmark: Annotated[Path, typer.Argument(help="Folder of `physconvex generate benchmark`.")],
    out: Annotated[Path, typer.Option(help="Folder of the results; finished parts are reused.")] = Path("paper"),
    name: Annotated[list[str] | None, typer.Option(help="Evaluate only this object; repeatable. Default: all.")] = None,
    part: Annotated[
        list[str] | None, typer.Option(help="Compute only this part, such as convex_twin; repeatable. Default: all.")
    ] = None,
    comparisons: Annotated[
        bool, typer.Option(help="Also run the method of the paper and the ablations over M and K.")
    ] = True,
    options: PaperOptions,
    no_progress: Annotated[bool, typer.Option("--no-progress", help="Hide progress messages.")] = False,
) -> None:
    """Print the tables of the paper: identification, images, future, generalisation and ablations.

    Baselines: a constant guess, the network alone, and the method of the paper. Writes tables.md, paper.json and
    objects/NAME.json. It can be stopped at any time; the same command resumes after the last finished part. It
    evaluates the objects that `generate benchmark` has finished.
    """

    from train.paper.evaluation import evaluate_paper
    from train.paper.tables import markdown, summary

    def say(name: str, part: str) -> None:
        if not no_progress:
            print(f"physconvex evaluate paper: {name}: {part} …", file=sys.stderr, flush=True)

    rows = evaluate_paper(benchmark, out, options, names=name, parts=part, comparisons=comparisons, on_part=say)
    made = json.loads((benchmark / "benchmark.json").read_text(encoding="utf-8"))["options"]
    note = (
        f"{len(rows)} of {made['count']} objects, {made['size']}² pixels, {made['views']} views, "
        f"{made['observed_frames']} of {made['frames']} frames observed from the front; truth of at most "
        f"{made['nodes']} nodes and {made['steps_per_frame']} steps per frame."
    )
    content = {"benchmark": made, "summary": asdict(summary(rows)), "objects": [row.to_json() for row in rows]}
    (out / "paper.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    (out / "tables.md").write_text(markdown(rows, note), encoding="utf-8")
    typer.echo((out / "tables.md").read_text(encoding="utf-8"))
