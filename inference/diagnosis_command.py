"""The command `physconvex diagnose`."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from physconvex.gap import GapOptions
from physconvex.io import command, load_capture

if TYPE_CHECKING:
    from inference.reconstruction import Reconstruction
    from physconvex.gap import GapReport
    from physconvex.io import Capture


@command
def diagnose_command(
    capture: Annotated[
        Path,
        typer.Argument(help="Capture folder: capture.json, and tracks or videos.", show_default=False),
    ],
    options: GapOptions,
    *,
    second_take: Annotated[
        Path | None,
        typer.Option(
            help="Second capture of the same body, its rest geometry in it or reconstructed too; the reduction of the "
            "gap is reported on it as well."
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the report.")] = Path("diagnosis"),
    body: Annotated[
        Path | None,
        typer.Option(
            help="Mesh of the closed surface at t = 0 [m], in place of the capture's. Default: that of the capture, "
            "else reconstructed from the first frames of its cameras."
        ),
    ] = None,
    effects: Annotated[str | None, typer.Option(help="Effects to test, separated by commas. Default: all.")] = None,
    without: Annotated[str | None, typer.Option(help="Effects to leave out, separated by commas.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print only report.json, to standard output.")] = False,
    no_progress: Annotated[bool, typer.Option("--no-progress", help="Hide the progress bar.")] = False,
) -> None:
    """Find where the sim-to-real gap of a capture lies, which effect causes it, and how far that effect reduces it.

    Writes report.json, report.html and body.ply into OUT. Open report.html in a browser.

    Exit code 0: done. 1: the base model cannot be simulated. 2: wrong usage or an incomplete capture.
    """
    from tqdm import tqdm

    from inference.rest_geometry import rest_geometry_of
    from physconvex.gap import diagnose

    with tqdm(total=None, dynamic_ncols=True, disable=no_progress or as_json or not sys.stderr.isatty()) as bar:

        def show(text: str) -> None:
            bar.set_description(text)
            bar.update()

        def of(folder: Path, results: Path, body: Path | None = None) -> tuple[Capture, Reconstruction | None]:
            return rest_geometry_of(load_capture(folder), body=body, out=results, on_stage=lambda name, _: show(name))

        source, made = of(capture, out, body)
        again = None if second_take is None else of(second_take, out / "second_take")[0]
        report = diagnose(
            source, second_take=again, effects=_names(effects), without=_names(without) or (), options=options,
            on_progress=show,
        )  # fmt: skip
    report = _with_error_of_body(report, made)
    report.save(out)
    if as_json:
        typer.echo(json.dumps(report.to_json()))
        return
    typer.echo(report.verdict.sentence)
    for caveat in report.verdict.caveats:
        typer.echo(f"  {caveat}")
    main = report.how_far[0]
    typer.echo(
        f"Gap on {main.data}: {1e3 * main.gap_before:.3g} mm before, {1e3 * main.gap_after:.3g} mm after "
        f"(floor {1e3 * main.noise_floor:.3g} mm)."
    )
    typer.echo(f"Report: {out / 'report.html'}")


def _with_error_of_body(report: GapReport, made: Reconstruction | None) -> GapReport:
    """The report, with what is known of the error of a reconstructed body."""
    if made is None:
        return report
    told = list(made.warnings)
    if made.error is not None:
        told.append(
            f"The body is reconstructed from pictures. Its surface is {1e3 * made.error.deviation:.2g} mm off (rms), "
            "which no interval and no probability includes."
        )
    return replace(report, verdict=replace(report.verdict, caveats=(*report.verdict.caveats, *told)))


def _names(text: str | None) -> list[str] | None:
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]
