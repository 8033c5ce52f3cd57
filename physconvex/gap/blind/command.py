"""The commands `physconvex evaluate gap`: captures with sealed labels, blind diagnosis, score."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

__all__ = ["app"]

app = typer.Typer(no_args_is_help=True, help=__doc__)


@app.command()
def generate(
    out: Annotated[Path, typer.Option(help="New folder of the captures.")],
    seal: Annotated[Path, typer.Option(help="New file of the labels; keep it from whoever diagnoses.")],
    count: Annotated[int, typer.Option(help="Number of captures.")] = 16,
    seed: Annotated[int, typer.Option(help="Seed of the draws.")] = 0,
    effects: Annotated[str | None, typer.Option(help="Names to draw from, separated by commas.")] = None,
    effect_free: Annotated[float, typer.Option(help="Share of captures without an effect.")] = 0.25,
    two: Annotated[float, typer.Option(help="Share of captures with two effects.")] = 0.0,
    outside: Annotated[float, typer.Option(help="Share of captures whose effect is in no dictionary.")] = 0.0,
    controls: Annotated[
        str | None, typer.Option(help="Controls, one more capture each: density, numerics, camera, noise.")
    ] = None,
    visibilities: Annotated[
        str, typer.Option(help="Gap over noise and numerical error that doses are scaled to, taken in turn.")
    ] = "10",
    engine: Annotated[
        str, typer.Option(help="explicit (an engine of its own) or fem (the full-order model).")
    ] = "explicit",
) -> None:
    """Simulate marker captures with hidden effects; publish the labels' hash only."""
    from tqdm import tqdm

    from physconvex.errors import InputError
    from physconvex.gap.blind.bank import generate_bank

    names = None if effects is None else [n.strip() for n in effects.split(",")]
    if engine not in ("explicit", "fem"):
        raise InputError(f"engine: got {engine!r}; expected explicit or fem")
    with tqdm(total=count, dynamic_ncols=True) as bar:
        count = generate_bank(
            out, seal, count=count, seed=seed, effects=names, effect_free=effect_free, two=two,
            outside=outside, engine="fem" if engine == "fem" else "explicit",
            controls=[] if controls is None else [n.strip() for n in controls.split(",")],
            visibilities=[float(v) for v in visibilities.split(",")],
            report=lambda name: (bar.set_description(name), bar.update())[0],
        )  # fmt: skip
    typer.echo(f"{count} captures in {out}; labels in {seal}")


@app.command()
def diagnose(
    captures: Annotated[Path, typer.Option(help="Folder of the captures.")],
    out: Annotated[Path, typer.Option(help="Folder of the reports and of answers.json.")],
    without: Annotated[
        str | None, typer.Option(help="Effects that are taken out of the dictionary, separated by commas.")
    ] = None,
) -> None:
    """Diagnose every capture with the default settings; goes on where it stopped."""
    from tqdm import tqdm

    from physconvex.gap.blind.bank import diagnose_bank

    names = [] if without is None else [n.strip() for n in without.split(",")]
    with tqdm(dynamic_ncols=True) as bar:
        path = diagnose_bank(
            captures, out, without=names, report=lambda name: (bar.set_description(name), bar.update())[0]
        )
    typer.echo(f"answers and their hash in {path}")


@app.command()
def score(
    captures: Annotated[Path, typer.Option(help="Folder of the captures.")],
    seal: Annotated[Path, typer.Option(help="File of the labels.")],
    answers: Annotated[Path, typer.Option(help="answers.json.")],
    out: Annotated[Path, typer.Option(help="File of the result (JSON).")] = Path("gap_score.json"),
) -> None:
    """Open the seal and score the answers."""
    from physconvex.gap.blind.scoring import score_bank

    result = score_bank(captures, seal, answers)
    out.write_text(json.dumps(asdict(result), indent=1) + "\n", encoding="utf-8")
    for name, value in asdict(result).items():
        if name in ("rows", "controls"):
            continue
        typer.echo(f"{name:18s} {value:.2f}" if isinstance(value, float) else f"{name:18s} {value}")
    for control in result.controls:
        typer.echo(
            f"control {control.name}: {control.verdict} {', '.join(control.effects)}: "
            f"{'right' if control.right else 'wrong'}"
        )
    for row in result.rows:
        typer.echo(f"{row['capture']}  truth {row['truth']}  verdict {row['verdict']}  first {row.get('first')}")
