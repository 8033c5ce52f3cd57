"""Test the diagnosis blindly: captures with sealed labels, answers, scores."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from data_gen import BankOptions, generate_bank
from physconvex.io import Options, command

if TYPE_CHECKING:
    from train.blind.scoring import BankScore


class ScoreFiles(Options):
    """Where a score is written."""

    out: Path = Path("gap_score.json")
    """JSON file of the result."""
    tables: Path | None = None
    """Markdown file of the result."""
    figure: Path | None = None
    """Figure file: confusion, reliability, visibility."""


app = typer.Typer(no_args_is_help=True, add_completion=False, help=__doc__)


@app.command()
@command
def generate(
    options: BankOptions,
    *,
    out: Annotated[Path, typer.Option(help="New folder of the captures.", show_default=False)],
    seal: Annotated[
        Path, typer.Option(help="New file of the labels; the diagnosis must not read it.", show_default=False)
    ],
) -> None:
    """Simulate marker captures with hidden effects, and publish only the hash of the labels. Resumes."""
    with _advancing(options.count) as report:
        count = generate_bank(out, seal, options, report=report)
    typer.echo(f"{count} captures in {out}; labels in {seal}")


@app.command("diagnose")
def diagnose_blindly(
    captures: Annotated[Path, typer.Option(help="Folder of the captures.")],
    out: Annotated[Path, typer.Option(help="Folder of the reports and of answers.json.")],
    without: Annotated[
        str | None, typer.Option(help="Effects to remove from the dictionary, separated by commas.")
    ] = None,
    workers: Annotated[int, typer.Option(help="Worker processes; each diagnoses one capture at a time.")] = 1,
) -> None:
    """Diagnose every capture with the default settings. Resumes."""
    from train.blind.answers import diagnose_bank

    names = [] if without is None else [n.strip() for n in without.split(",")]
    with _advancing() as report:
        path = diagnose_bank(captures, out, without=names, workers=workers, report=report)
    typer.echo(f"answers and their hash in {path}")


@app.command("score")
@command
def score_answers(
    *,
    captures: Annotated[list[Path], typer.Option(help="Folder of the captures; repeatable, one per bank.")],
    seal: Annotated[list[Path], typer.Option(help="File of the labels; repeatable, one per bank.")],
    answers: Annotated[list[Path], typer.Option(help="File answers.json; repeatable, one per bank.")],
    oracle: Annotated[list[Path] | None, typer.Option(help="Folder of `oracle`; repeatable, one per bank.")] = None,
    files: ScoreFiles,
) -> None:
    """Open the seals and score the answers of one or several banks."""
    from physconvex import InputError
    from train.blind.scoring import Bank, score_banks

    oracles: list[Path | None] = list(oracle) if oracle else [None for _ in captures]
    if not len(captures) == len(seal) == len(answers) == len(oracles):
        raise InputError(
            f"seal, answers, oracle: got {len(seal)}, {len(answers)} and {len(oracles)}; expected one for each of "
            f"{len(captures)} banks"
        )
    _write(score_banks(*map(Bank, captures, seal, answers, oracles)), files)


@app.command()
@command
def pool(
    results: Annotated[list[Path], typer.Argument(help="JSON files written by `score`, one per bank.")],
    files: ScoreFiles,
) -> None:
    """Combine stored scores of several banks."""
    from train.blind.summary import pool_scores

    _write(pool_scores(results), files)


def _write(result: BankScore, files: ScoreFiles) -> None:
    from train.blind.summary import draw_score, score_json, score_markdown

    files.out.write_text(score_json(result), encoding="utf-8")
    text = score_markdown(result)
    if files.tables is not None:
        files.tables.write_text(text, encoding="utf-8")
    if files.figure is not None:
        draw_score(result, files.figure)
    typer.echo(text)


@contextmanager
def _advancing(total: int | None = None) -> Iterator[Callable[[str], None]]:
    """A bar that each report of a name moves by one."""
    from tqdm import tqdm

    with tqdm(total=total, dynamic_ncols=True) as bar:

        def advance(name: str) -> None:
            bar.set_description(name)
            bar.update()

        yield advance


@app.command()
def oracle(
    captures: Annotated[Path, typer.Option(help="Folder of the captures.")],
    seal: Annotated[Path, typer.Option(help="File of the labels.")],
    answers: Annotated[Path, typer.Option(help="File answers.json; it is hashed before the seal is opened.")],
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    workers: Annotated[int, typer.Option(help="Worker processes; each diagnoses one capture at a time.")] = 1,
) -> None:
    """Open the seal and fit each visible single effect alone. Resumes."""
    from train.blind.oracle import run_oracle
    from train.blind.scoring import Bank

    with _advancing() as report:
        run_oracle(Bank(captures, seal, answers), out, workers=workers, report=report)
