"""Combined score of several banks from their stored results, without the captures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from data_gen import ControlScore
from physconvex import InputError
from train.blind.rows import Row
from train.blind.scoring import BankScore, score_rows


@dataclass(frozen=True)
class _Stored:
    """Fields of a stored score that determine the rest."""

    rows: tuple[Row, ...]
    controls: tuple[ControlScore, ...]
    undrawn: int


def pool_scores(results: Sequence[Path]) -> BankScore:
    """The score of all captures of banks that have a score each.

    Args:
        results: files that `score` writes.

    Raises:
        InputError: no result is given, one cannot be read, or a capture is in two of them.
    """
    if not results:
        raise InputError("results: got none; expected files that `physconvex evaluate gap score` wrote")
    banks = [_stored(path) for path in results]
    rows = [row for bank in banks for row in bank.rows]
    names = [row.capture for row in rows]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"results: {twice[0]} is in two of them; expected each bank once")
    controls = tuple(control for bank in banks for control in bank.controls)
    return score_rows(rows, controls, sum(bank.undrawn for bank in banks))


def _stored(path: Path) -> _Stored:
    try:
        content = TypeAdapter(dict[str, Any]).validate_json(path.read_bytes())
        rows = TypeAdapter(list[dict[str, Any]]).validate_python(content.get("rows"))
        return TypeAdapter(_Stored).validate_python(content | {"rows": [_row(row) for row in rows]})
    except (OSError, ValidationError) as error:
        raise InputError(f"{path}: no result of `physconvex evaluate gap score`, or an older one: {error}") from error


def _row(row: dict[str, Any]) -> dict[str, Any]:
    """Unknown numbers are null in the file."""
    return {name: value if name == "dose" else _number(value) for name, value in row.items()}


def _number(value: Any) -> Any:
    if isinstance(value, list):
        return [_number(part) for part in value]
    return float("nan") if value is None else value
