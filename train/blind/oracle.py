"""Shrinkage by the hidden effect alone, if it is known: the limit of what a diagnosis can reach."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

from data_gen import run_jobs
from physconvex import PhysconvexError
from physconvex.gap import GapOptions, diagnose
from train.blind.scoring import VISIBLE, Bank, score_banks

Report = Callable[[str], None]


def run_oracle(
    bank: Bank, out: Path, *, options: GapOptions | None = None, workers: int = 1, report: Report = lambda _: None
) -> None:
    """Diagnose captures that hide one visible effect with that effect alone; resumes an interrupted run.

    This opens the seal, so the answers are read first and must have a hash.

    Args:
        bank: bank with answers.
        out: folder of the results, one file per capture: the share of the held-out gap that the effect removes.
        options: settings.
        workers: processes, of one capture each.
        report: receives progress messages.

    Raises:
        InputError: as `score_banks`.
    """
    out.mkdir(parents=True, exist_ok=True)
    calls = {}
    for row in score_banks(bank).rows:
        name = row.capture.removeprefix(f"{bank.name}/")
        if row.single and row.visibility >= VISIBLE and not (out / f"{name}.json").exists():
            calls[name] = partial(_shrink, bank.captures / name, out / f"{name}.json", row.truth, options)
    run_jobs(calls, workers=workers, report=report)


def _shrink(capture: Path, target: Path, effects: tuple[str, ...], options: GapOptions | None) -> None:
    value: float | None
    try:
        value = diagnose(capture, effects=effects, options=options).how_far[0].shrinkage
    except PhysconvexError:
        value = None
    target.write_text(json.dumps({"effects": effects, "shrinkage": value}), encoding="utf-8")
