"""Blind tests of the diagnosis: captures with sealed labels, answers, score."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from data_gen import BankOptions, generate_bank
from physconvex.io import command

if TYPE_CHECKING:
    from train.blind.scoring import BankScore

app = typer.Typer(no_args_is_help=True, add_completion=False, help=__doc__)


@app.command()
@command
def generate(
    options: BankOptions,
    *,
    out: Annotated[Path, typer.Option(help="New folder of the captures.", show_default=False)],
    seal: Annotated[
        Path, typer.Option(help="New file of the labels; keep it from whoever diagnoses.", show_default=False)
    ],
) -> None:
    """Simulate marker captures with hidden effects; publish the labels' hash only. Goes on where it stopped."""
    from tqdm import tqdm

    with tqdm(total=options.count, dynamic_ncols=True) as bar:
        count = generate_bank(out, seal, options, report=lambda name: (bar.set_description(name), bar.update())[0])
    typer.echo(f"{count} captures in {out}; labels in {seal}")


@app.command("diagnose")
def diagnose_blindly(
    captures: Annotated[Path, typer.Option(help="Folder of the captures.")],
    out: Annotated[Path, typer.Option(help="Folder of the reports and of answers.json.")],
    without: Annotated[
        str | None, typer.Option(help="Effects that are taken out of the dictionary, separated by commas.")
    ] = None,
    workers: Annotated[int, typer.Option(help="Processes, of one capture each.")] = 1,
) -> None:
    """Diagnose every capture with the default settings; goes on where it stopped."""
    from tqdm import tqdm

    from train.blind.answers import diagnose_bank

    names = [] if without is None else [n.strip() for n in without.split(",")]
    with tqdm(dynamic_ncols=True) as bar:
        path = diagnose_bank(
            captures,
            out,
            without=names,
            workers=workers,
            report=lambda name: (bar.set_description(name), bar.update())[0],
        )
    typer.echo(f"answers and their hash in {path}")


@app.command("score")
def score_answers(
    *,
    captures: Annotated[list[Path], typer.Option(help="Folder of the captures; several banks are counted together.")],
    seal: Annotated[list[Path], typer.Option(help="File of the labels, of each bank.")],
    answers: Annotated[list[Path], typer.Option(help="answers.json, of each bank.")],
    oracle: Annotated[list[Path] | None, typer.Option(help="Folder of `oracle`, of each bank.")] = None,
    out: Annotated[Path, typer.Option(help="File of the result (JSON).")] = Path("gap_score.json"),
    tables: Annotated[Path | None, typer.Option(help="File of the result to read (Markdown).")] = None,
    figure: Annotated[Path | None, typer.Option(help="Picture: confusion, reliability, visibility.")] = None,
) -> None:
    """Open the seals and score the answers."""
    from physconvex import InputError
    from train.blind.scoring import Bank, score_banks

    oracles: list[Path | None] = list(oracle) if oracle else [None for _ in captures]
    if not len(captures) == len(seal) == len(answers) == len(oracles):
        raise InputError(
            f"seal, answers, oracle: got {len(seal)}, {len(answers)} and {len(oracles)}; expected one for each of "
            f"{len(captures)} banks"
        )
    _write(score_banks(*map(Bank, captures, seal, answers, oracles)), out, tables, figure)


@app.command()
def pool(
    results: Annotated[list[Path], typer.Argument(help="Files that `score` wrote, one of each bank.")],
    out: Annotated[Path, typer.Option(help="File of the result (JSON).")] = Path("gap_score.json"),
    tables: Annotated[Path | None, typer.Option(help="File of the result to read (Markdown).")] = None,
    figure: Annotated[Path | None, typer.Option(help="Picture: confusion, reliability, visibility.")] = None,
) -> None:
    """Count the captures of banks that were scored before together."""
    from train.blind.pooling import pool_scores

    _write(pool_scores(results), out, tables, figure)


def _write(result: BankScore, out: Path, tables: Path | None, figure: Path | None) -> None:
    from train.blind.summary import draw_score, score_json, score_markdown

    out.write_text(score_json(result), encoding="utf-8")
    text = score_markdown(result)
    if tables is not None:
        tables.write_text(text, encoding="utf-8")
    if figure is not None:
        draw_score(result, figure)
    typer.echo(text)


@app.command()
def oracle(
    captures: Annotated[Path, typer.Option(help="Folder of the captures.")],
    seal: Annotated[Path, typer.Option(help="File of the labels.")],
    answers: Annotated[Path, typer.Option(help="answers.json, hashed before the seal is opened.")],
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    workers: Annotated[int, typer.Option(help="Processes, of one capture each.")] = 1,
) -> None:
    """Open the seal and diagnose each visible single effect with that effect alone; goes on where it stopped."""
    from tqdm import tqdm

    from train.blind.oracle import run_oracle
    from train.blind.scoring import Bank

    with tqdm(dynamic_ncols=True) as bar:
        run_oracle(
            Bank(captures, seal, answers), out, workers=workers,
            report=lambda name: (bar.set_description(name), bar.update())[0],
        )  # fmt: skip
