"""The command `physconvex predict`."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from inference.settings import BatchOptions, StatedConditions
from inference.table import ResultRow
from physconvex.io import command

if TYPE_CHECKING:
    from inference.batch import BatchSummary

_ROWS_SHOWN = 40


@command
def predict_command(
    *,
    paths: Annotated[
        list[Path],
        typer.Argument(
            help="Video files, capture folders, folders of numbered images, or folders that contain them. "
            "NAME_mask.mp4 beside NAME.mp4 is its mask.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("predictions"),
    conditions: StatedConditions,
    checkpoint: Annotated[str, typer.Option(help="Name or folder of a checkpoint.")] = "default",
    device: Annotated[str, typer.Option(help="Torch device, such as cpu or cuda.")] = "cpu",
    work: BatchOptions,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print only one JSON object per clip, to standard output.")
    ] = False,
    redo: Annotated[bool, typer.Option("--redo", help="Predict finished clips again.")] = False,
    no_progress: Annotated[bool, typer.Option("--no-progress", help="Hide the progress bar.")] = False,
) -> None:
    """Predict Young's modulus, Poisson's ratio and skinning weights of the object in each clip.

    Writes predictions.csv, predictions.parquet, gallery.html and, per clip, JSON and skinning weights.
    It can be stopped at any time; the same command resumes.

    Exit code 0: all clips are predicted. 1: some clips fail or are truncated; each is named. 2: wrong usage.
    """
    # Waiting threads of the network must not spin: clips are read on the same cores. Torch reads this when it is
    # loaded;
    # with both cores busy a pass of the tiny network takes 47 ms of processor time per clip, 195 with spinning.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")

    from tqdm import tqdm

    from inference.batch import predict_batch

    shown = not no_progress and sys.stderr.isatty()
    with tqdm(unit="clip", disable=not shown, file=sys.stderr, dynamic_ncols=True) as bar:

        def report(row: ResultRow) -> None:
            if problem := row.error or row.truncated:
                bar.write(f"physconvex predict: {problem}", file=sys.stderr)
            if as_json:
                print(json.dumps(_record(row, out), ensure_ascii=False), flush=True)
            bar.update()

        summary = predict_batch(
            paths,
            out=out,
            checkpoint=checkpoint,
            device=device,
            redo=redo,
            on_start=bar.reset,
            on_row=report,
            **dict(conditions),
            **dict(work),
        )
    if not summary.rows:
        names = ", ".join(str(path) for path in paths)
        print(f"physconvex predict: {names}: no video, capture or image folder in it", file=sys.stderr)
        raise typer.Exit(1)
    if not as_json:
        _print_summary(summary)
    raise typer.Exit(summary.exit_code)


def _record(row: ResultRow, out: Path) -> object:
    if row.error:
        return {"path": row.path, "error": row.error}
    return {"error": "", **json.loads((out / "clips" / f"{row.name}.json").read_text(encoding="utf-8"))}


def _print_summary(summary: BatchSummary) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    table = Table(caption=None)
    table.add_column("clip", overflow="fold")
    table.add_column("Young's modulus (90 %)", justify="right", no_wrap=True)
    table.add_column("Poisson's ratio (90 %)", justify="right", no_wrap=True)
    table.add_column("note", overflow="fold")
    for row in summary.rows[:_ROWS_SHOWN]:
        table.add_row(*_cells(row))
    console.print(table)
    if len(summary.rows) > _ROWS_SHOWN:
        console.print(f"… and {len(summary.rows) - _ROWS_SHOWN} more in predictions.csv", highlight=False)
    counts = f"{summary.predicted} predicted, {summary.resumed} finished earlier, {summary.failed} failed"
    if summary.truncated:
        counts += f"; {summary.truncated} from files that are cut short"
    console.print(counts, highlight=False)
    console.print("look at:", str(summary.out / "gallery.html"), highlight=False, soft_wrap=True)
    console.print("tables: ", str(summary.out / "predictions.csv"), highlight=False, soft_wrap=True)


def _cells(row: ResultRow) -> tuple[str, str, str, str]:
    from rich.markup import escape

    from inference.units import format_pascals, format_pascals_range

    if row.error:
        return escape(row.path), "–", "–", f"[red]{escape(row.error.removeprefix(row.path + ': '))}[/red]"
    assert row.youngs_modulus is not None
    assert row.youngs_modulus_low is not None and row.youngs_modulus_high is not None
    stiffness = format_pascals_range(row.youngs_modulus_low, row.youngs_modulus_high)
    ratio = f"{row.poisson_ratio:.2f} ({row.poisson_ratio_low:.2f}–{row.poisson_ratio_high:.2f})"
    assumed = f"assumed {row.assumed.replace('; ', ', ')}" if row.assumed else ""
    notes = "; ".join(part for part in (assumed, row.warnings) if part)
    return escape(row.path), f"{format_pascals(row.youngs_modulus)} ({stiffness})", ratio, escape(notes)
