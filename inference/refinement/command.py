"""The command `physconvex refine`."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inference.refinement.options import RefineOptions
from physconvex.io import command

if TYPE_CHECKING:
    from inference.refinement.result import Refinement

_RESULT = "Results"


@command
def refine_command(
    *,
    capture: Annotated[Path, typer.Argument(help="Capture folder: capture.json, rest shape, and tracks or videos.")],
    out: Annotated[
        Path,
        typer.Option(help="Folder of the results; finished stages are reused.", rich_help_panel=_RESULT),
    ] = Path("refinement"),
    options: RefineOptions,
    processes: Annotated[
        int | None,
        typer.Option(help="Number of simulations at once. Default: one per core.", rich_help_panel=_RESULT),
    ] = None,
    pictures: Annotated[bool, typer.Option(help="Write fit.png and side_by_side.mp4.", rich_help_panel=_RESULT)] = True,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print only refinement.json, to standard output.", rich_help_panel=_RESULT)
    ] = False,
    no_progress: Annotated[
        bool, typer.Option("--no-progress", help="Hide progress messages.", rich_help_panel=_RESULT)
    ] = False,
) -> None:
    """Estimate E, ν, damping and initial motion of a capture by differentiable simulation, and predict its future.

    Writes refinement.json, trajectory.npz, fit.png, side_by_side.mp4 and run.json. It can be stopped at any time; the
    same command resumes after the last finished stage.
    """
    from inference.refinement.pipeline import refine
    from inference.refinement.result_files import write_refinement
    from inference.refinement.stages import stage_in_words

    options = options.replace(processes=(os.cpu_count() or 1) if processes is None else processes)

    def say(stage: str, stored: bool) -> None:
        if not no_progress:
            note = " (read again)" if stored else " …"
            print(f"physconvex refine: {stage_in_words(stage)}{note}", file=sys.stderr, flush=True)

    found = refine(capture, out=out, options=options, on_stage=say)
    write_refinement(found, out, options=options, pictures=pictures)
    if as_json:
        typer.echo(json.dumps(found.to_json(), ensure_ascii=False, allow_nan=False))
    else:
        _print(found, out)


def _print(found: Refinement, out: Path) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console, table = Console(), Table()
    errors = ("noise σ", "model error", *(() if found.reconstruction is None else ("geometry error",)))
    for column in ("parameter", "value", "90 % interval", *errors):
        table.add_column(column, justify="left" if column == "parameter" else "right")
    for e in found.estimates:
        parts = (e.noise_sigma, e.model_error, e.geometry_error)[: len(errors)]
        table.add_row(escape(e.label), f"{e.value:.5g}", e.interval_in_words, *(f"{part:.2g}" for part in parts))
    console.print(table)
    if found.reconstruction is not None:
        console.print(str(found.reconstruction), highlight=False, soft_wrap=True)
    console.print(f"Young's modulus {found.youngs_modulus:.4g} Pa, Poisson's ratio {found.poisson_ratio:.4f}")
    for sentence in (*found.identifiability.sentences, *found.warnings):
        console.print(sentence, highlight=False, markup=False)
    console.print("look at:", str(out / "fit.png"), highlight=False, soft_wrap=True)
