"""Diagnoses of a bank's captures, without knowledge of the labels."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from data_gen import DICTIONARY, digest, run_jobs
from physconvex import InputError, PhysconvexError
from physconvex.gap import GapOptions, diagnose

Report = Callable[[str], None]


def diagnose_bank(
    captures: Path, out: Path, *, without: Sequence[str] = (), options: GapOptions | None = None, workers: int = 1,
    report: Report = lambda _: None,
) -> Path:  # fmt: skip
    """Diagnose every capture of a bank and write answers.json; existing answers are kept.

    After an interruption, answers.json has the answers so far; `score` counts the others as errors.

    Args:
        captures: folder of the captures; its `dictionary.json` lists effects that are left out for some.
        out: folder of the reports.
        without: effects that are removed from the dictionary; captures that hide one count as `outside`.
        options: settings.
        workers: processes, of one capture each.
        report: receives progress messages.

    Returns:
        Path of answers.json.

    Raises:
        InputError: there are no captures.
    """
    folders = sorted(path.parent for path in captures.glob("*/capture.json"))
    if not folders:
        raise InputError(f"{captures}: no capture folders in it; make some with `physconvex evaluate gap generate`")
    listed = captures / DICTIONARY
    deleted = json.loads(listed.read_text(encoding="utf-8")) if listed.exists() else {}
    jobs = [
        _Job(folder, out / folder.name, tuple(dict.fromkeys([*without, *deleted.get(folder.name, ())])), options)
        for folder in folders
    ]
    try:
        run_jobs({job.name: partial(_diagnose, job) for job in jobs if not job.done}, workers=workers, report=report)
    finally:
        path = _write(out, [_answer(job) for job in jobs if job.answered], without)
    return path


def _write(out: Path, answers: Sequence[dict[str, Any]], without: Sequence[str]) -> Path:
    path, text = out / "answers.json", json.dumps(answers, indent=1)
    content = {"sha256": digest(text, ""), "without": list(without), "answers": list(answers)}
    out.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return path


@dataclass(frozen=True)
class _Job:
    """One capture, the destination of its report, and the effects that are left out."""

    folder: Path
    target: Path
    without: tuple[str, ...]
    options: GapOptions | None

    @property
    def name(self) -> str:
        return self.folder.name

    @property
    def done(self) -> bool:
        return (self.target / "report.json").exists()

    @property
    def answered(self) -> bool:
        return self.done or (self.target / "error.txt").exists()


def _diagnose(job: _Job) -> None:
    try:
        diagnose(job.folder, without=job.without, options=job.options).save(job.target)
    except PhysconvexError as error:
        job.target.mkdir(parents=True, exist_ok=True)
        (job.target / "error.txt").write_text(f"{error}\n", encoding="utf-8")


def _answer(job: _Job) -> dict[str, Any]:
    if not job.done:
        return {"capture": job.name, "error": (job.target / "error.txt").read_text(encoding="utf-8").strip()}
    content = json.loads((job.target / "report.json").read_text(encoding="utf-8"))
    which, how_far = content["which"], content["how_far"]
    material = {row["name"]: row for row in how_far["parameters"]}
    fits = [h["effects"] for h in which["hypotheses"] if h["effects"]]
    return {
        "capture": job.name,
        "without": list(job.without),
        "verdict": which["verdict"],
        "none_probability": which["none_probability"],
        "known": likeliest_known(which),
        "effects": [{k: e[k] for k in ("name", "variant", "source", "probability", "parameters", "confused_with")}
                    for e in which["effects"]],
        "ranking": fits,
        "shrinkage": how_far["shrinkage"],
        "placebo": how_far["placebo"],
        "gap_before": how_far["gap_before"],
        "gap_after": how_far["gap_after"],
        "noise_floor": how_far["noise_floor"],
        "log10_youngs_modulus": [material[n][k] for n in ("log10_youngs_modulus",) for k in ("before", "after")],
        "poisson_ratio": [material[n][k] for n in ("poisson_ratio",) for k in ("before", "after")],
        "seconds": content["provenance"]["seconds"],
    }  # fmt: skip


def likeliest_known(which: dict[str, Any]) -> float:
    """Probability of the likeliest effect by the evidence of the fits alone, independent of the verdict.

    Only the best fit with the same effects counts; numerical effects are excluded.

    Args:
        which: that part of a report.json.
    """
    numerical = {row["effect"] for row in which["screening"] if row["source"] == "numerical"}
    best: dict[frozenset[str], float] = {}
    for fit in which["hypotheses"]:
        names = frozenset(fit["effects"])
        best[names] = max(best.get(names, -np.inf), fit["evidence"])
    evidence = np.array(list(best.values()))
    weights = np.exp(evidence - evidence.max())
    known = frozenset().union(*best) - numerical
    return max((float(weights[[name in names for names in best]].sum() / weights.sum()) for name in known), default=0.0)
