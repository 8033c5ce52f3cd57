"""The score of a blind test: the seal is opened and compared with the answers."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from physconvex.errors import InputError
from physconvex.gap.blind.bank import COMMITMENT, digest
from physconvex.gap.blind.classes import same_class
from physconvex.gap.blind.controls import ControlScore, score_controls
from physconvex.gap.blind.explicit_cases import OUTSIDE

__all__ = ["BankScore", "score_bank"]


@dataclass(frozen=True)
class BankScore:
    """Result of a blind test.

    Attributes:
        captures: number of captures that were answered.
        errors: number that were not.
        with_effect: number that hide one effect of the dictionary.
        top_1, top_2: share of those whose effect leads the fits, or is among the first two; exact names.
        top_1_merged: the same with the declared confusion classes merged.
        called: share of them with the verdict "effect" and the right class.
        effect_free: number without effect.
        false_alarms: share of those with the verdict "effect".
        median_shrinkage: of captures with an effect.
        two_effects: number that hide two.
        recall, precision: share of their effects that the best fit names, and of what it names that is hidden, classes
            merged.
        outside: number whose effect is in no dictionary.
        unknown: share of those whose verdict is not "effect".
        shuffled: `top_1_merged` if labels were dealt at random to the captures with one effect: what chance gives.
        controls: their answers.
        rows: one per capture.
    """

    captures: int
    errors: int
    with_effect: int
    top_1: float
    top_2: float
    top_1_merged: float
    called: float
    effect_free: int
    false_alarms: float
    median_shrinkage: float
    two_effects: int
    recall: float
    precision: float
    outside: int
    unknown: float
    shuffled: float
    controls: tuple[ControlScore, ...]
    rows: tuple[dict[str, Any], ...]


def score_bank(captures: Path, seal: Path, answers: Path) -> BankScore:
    """Open the seal and compare.

    Raises:
        InputError: the seal does not belong to the captures, or the answers were changed after they were hashed.
    """
    sealed = json.loads(seal.read_text(encoding="utf-8"))
    commitment = json.loads((captures / COMMITMENT).read_text(encoding="utf-8"))
    if digest(sealed["labels"], sealed["salt"]) != commitment["sha256"]:
        raise InputError(f"{seal}: its hash differs from {captures / COMMITMENT}; it belongs to other captures")
    given = json.loads(answers.read_text(encoding="utf-8"))
    if digest(json.dumps(given["answers"], indent=1), "") != given["sha256"]:
        raise InputError(f"{answers}: its hash differs from its content; the answers were changed")
    by_name = {answer["capture"]: answer for answer in given["answers"]}
    labels, missing = json.loads(sealed["labels"]), {*OUTSIDE, *given.get("without", ())}
    rows = [_row(label, by_name.get(label["capture"])) for label in labels if not label.get("control")]
    answered = [row for row in rows if row["verdict"] is not None]
    outside = [row for row in answered if set(row["truth"]) & missing]
    hidden = [row for row in answered if len(row["truth"]) == 1 and row not in outside]
    both = [row for row in answered if len(row["truth"]) > 1]
    free = [row for row in answered if not row["truth"]]

    def share(part: list[dict[str, Any]], key: str) -> float:
        return float(np.mean([bool(row[key]) for row in part])) if part else float("nan")

    return BankScore(
        captures=len(answered),
        errors=len(rows) - len(answered),
        with_effect=len(hidden),
        top_1=share(hidden, "top_1"),
        top_2=share(hidden, "top_2"),
        top_1_merged=share(hidden, "top_1_merged"),
        called=share(hidden, "called"),
        effect_free=len(free),
        false_alarms=share(free, "alarm"),
        median_shrinkage=float(np.median([row["shrinkage"] for row in hidden])) if hidden else float("nan"),
        two_effects=len(both),
        recall=_mean([row["recall"] for row in both]),
        precision=_mean([row["precision"] for row in both]),
        outside=len(outside),
        unknown=_mean([row["verdict"] != "effect" for row in outside]),
        shuffled=_shuffled(hidden),
        controls=score_controls(labels, by_name),
        rows=tuple(rows),
    )


def _shuffled(hidden: list[dict[str, Any]]) -> float:
    """Mean over all ways to give each capture another one's label."""
    leaders = [row["first"][0] if row["first"] else "" for row in hidden]
    return _mean([
        same_class(leader, row["truth"][0])
        for i, leader in enumerate(leaders)
        for j, row in enumerate(hidden)
        if i != j
    ])  # fmt: skip


def _mean(values: list[Any]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _share_of(names: list[str], among: list[str]) -> float:
    """Share of names that are in the class of one of the others."""
    return float(np.mean([any(same_class(name, other) for other in among) for name in names])) if names else 0.0


def _row(label: dict[str, Any], answer: dict[str, Any] | None) -> dict[str, Any]:
    truth = [effect["name"] for effect in label["effects"]]
    row: dict[str, Any] = {
        "capture": label["capture"],
        "kind": label["kind"],
        "truth": truth,
        "doses": [list(zip(e["doses"], e["units"], strict=True)) for e in label["effects"]],
        "verdict": None,
    }
    if answer is None or "error" in answer:
        return row | {"error": None if answer is None else answer["error"]}
    ranking = [names for names in answer["ranking"] if names]
    leaders = [names[0] for names in ranking]
    leaders = list(dict.fromkeys(leaders))
    row |= {
        "verdict": answer["verdict"],
        "first": leaders[:2],
        "top_1": bool(truth) and leaders[:1] == truth[:1],
        "top_2": bool(truth) and truth[0] in leaders[:2],
        "top_1_merged": bool(truth) and bool(leaders) and same_class(leaders[0], truth[0]),
        "called": bool(truth) and answer["verdict"] == "effect" and same_class(answer["effects"][0]["name"], truth[0]),
        "alarm": answer["verdict"] == "effect",
        "recall": _share_of(truth, ranking[0] if ranking else []),
        "precision": _share_of(ranking[0] if ranking else [], truth),
        "visibility_wanted": label.get("visibility"),
        "shrinkage": answer["shrinkage"],
        "placebo": answer["placebo"],
        "visibility": answer["visibility"],
        "bias_log10_youngs_modulus": [
            v - float(np.log10(label["youngs_modulus"])) for v in answer["log10_youngs_modulus"]
        ],
        "bias_poisson_ratio": [v - label["poisson_ratio"] for v in answer["poisson_ratio"]],
        "answer": [(e["name"], e["probability"], [(p["value"], p["interval"]) for p in e["parameters"]])
                   for e in answer["effects"][:2]],
        "seconds": answer["seconds"],
    }  # fmt: skip
    return row
