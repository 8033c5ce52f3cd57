"""Blind test of the diagnosis: captures whose labels are sealed, answers, and their score."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from physconvex.capture import save_capture
from physconvex.errors import ConvergenceError, InputError, PhysconvexError
from physconvex.gap.blind.cases import BLIND_EFFECTS, Case, capture_parts, draw_case, kinds_for, simulate_case
from physconvex.gap.blind.explicit_cases import EXPLICIT_EFFECTS, OUTSIDE, simulate_explicit
from physconvex.gap.diagnose import diagnose
from physconvex.gap.options import GapOptions

__all__ = ["COMMITMENT", "CONFUSION_CLASSES", "BankScore", "diagnose_bank", "generate_bank", "score_bank"]

COMMITMENT = "commitment.json"
# declared before any blind run: effects that kinematics of one take does not tell apart
CONFUSION_CLASSES: tuple[frozenset[str], ...] = (
    frozenset({"damping", "viscoelasticity", "time_step", "restitution"}),
    frozenset({"gravity_tilt", "wind"}),
    frozenset({"initial_velocity", "time_offset"}),
    frozenset({"time_scale", "air_drag"}),
    frozenset({"anisotropy", "heterogeneity"}),
)
Report = Callable[[str], None]
EngineName = Literal["explicit", "fem"]


def _digest(text: str, salt: str) -> str:
    return hashlib.sha256((salt + text).encode()).hexdigest()


def generate_bank(
    out: Path,
    seal: Path,
    *,
    count: int,
    seed: int,
    effects: Sequence[str] | None = None,
    effect_free: float = 0.25,
    engine: EngineName = "explicit",
    visibilities: Sequence[float] = (10.0,),
    two: float = 0.0,
    outside: float = 0.0,
    report: Report = lambda _: None,
) -> int:
    """Write captures into `out`, their labels into the file `seal`, and the labels' hash beside the captures.

    Args:
        out: new folder of the captures.
        seal: new file of the labels, to be kept from whoever diagnoses.
        count: number of captures.
        seed: of the draws.
        effects: names that are drawn from; all that the engine knows unless given.
        effect_free: share of captures without any effect.
        engine: "explicit" (another engine than the diagnosis uses, doses by visibility) or "fem" (the full-order model
            on another mesh, doses by their size).
        visibilities: of the effects, taken in turn; see `simulate_explicit`.
        two: share of captures with two effects.
        outside: share of captures whose effect is in no dictionary.
        report: told what is done.

    Returns:
        Number of captures; draws whose simulation fails are drawn anew.

    Raises:
        InputError: a folder or file exists already, or an unknown effect.
    """
    known = EXPLICIT_EFFECTS if engine == "explicit" else BLIND_EFFECTS
    names = list(known if effects is None else effects)
    unknown = set(names) - set(known)
    if unknown:
        raise InputError(f"effects: got {sorted(unknown)}; expected names among {', '.join(known)}")
    for path in (out, seal):
        if path.exists():
            raise InputError(f"{path}: exists; choose another place for a new bank")
    out.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    plan = _plan(rng, count, names, {"free": effect_free, "two": two, "outside": outside})
    labels: list[dict[str, Any]] = []
    for number, hidden in enumerate(plan):
        name = f"capture_{number:03d}"
        report(name)
        case, seen = _written(out / name, hidden, rng, engine, float(visibilities[number % len(visibilities)]))
        labels.append({"capture": name, "kind": case.kind, "seed": case.seed, "youngs_modulus": case.youngs_modulus,
                       "poisson_ratio": case.poisson_ratio, "engine": engine, "visibility": seen,
                       "effects": [asdict(h) for h in case.hidden]})  # fmt: skip
    text = json.dumps(labels, indent=1)
    salt = secrets.token_hex(16)
    seal.parent.mkdir(parents=True, exist_ok=True)
    seal.write_text(json.dumps({"salt": salt, "labels": text}) + "\n", encoding="utf-8")
    commitment = {"sha256": _digest(text, salt), "captures": count, "hashed": "salt + labels"}
    (out / COMMITMENT).write_text(json.dumps(commitment, indent=1) + "\n", encoding="utf-8")
    return count


def _plan(
    rng: np.random.Generator, count: int, effects: list[str], shares: dict[str, float]
) -> list[tuple[str, ...]]:  # fmt: skip
    numbers = {key: round(share * count) for key, share in shares.items()}
    order = [effects[i] for i in rng.permutation(len(effects))]
    singles = count - sum(numbers.values())
    plan: list[tuple[str, ...]] = [()] * numbers["free"] + [(order[i % len(order)],) for i in range(singles)]
    plan += [(OUTSIDE[i % len(OUTSIDE)],) for i in range(numbers["outside"])]
    for number in range(numbers["two"]):
        first = order[(singles + number) % len(order)]
        together = [(a, b) for a in effects for b in effects if a != b and not same_class(a, b) and kinds_for((a, b))]
        if not together:
            raise InputError(f"effects: got {', '.join(effects)}; expected two that one motion can show, for `two`")
        plan.append(together[int(rng.choice([i for i, p in enumerate(together) if p[0] == first] or len(together)))])
    return [plan[i] for i in rng.permutation(count)]


def _written(
    folder: Path, names: tuple[str, ...], rng: np.random.Generator, engine: EngineName, visibility: float
) -> tuple[Case, float]:  # fmt: skip
    for _ in range(20):
        case, seen = draw_case(int(rng.integers(2**31)), names, dosed=engine == "fem"), float("nan")
        try:
            if engine == "fem":
                motion, positions = simulate_case(case)
            else:
                motion, positions, case, seen = simulate_explicit(case, names, visibility)
        except (ConvergenceError, InputError):
            continue
        if not np.isfinite(positions).all():
            continue
        capture, parts = capture_parts(case, positions, motion.rest, folder)
        save_capture(capture, **parts)
        return case, seen
    raise ConvergenceError(f"{folder.name}: twenty draws could not be simulated")


def diagnose_bank(
    captures: Path, out: Path, *, options: GapOptions | None = None, report: Report = lambda _: None
) -> Path:
    """Diagnose every capture of a bank and write answers.json; captures that have an answer are left.

    Returns:
        Path of answers.json.
    """
    folders = sorted(path.parent for path in captures.glob("*/capture.json"))
    if not folders:
        raise InputError(f"{captures}: no capture folders in it; make some with `physconvex evaluate gap generate`")
    answers = []
    for folder in folders:
        target = out / folder.name
        if not (target / "report.json").exists():
            report(folder.name)
            try:
                diagnose(folder, options=options).save(target)
            except PhysconvexError as error:
                target.mkdir(parents=True, exist_ok=True)
                (target / "error.txt").write_text(f"{error}\n", encoding="utf-8")
                answers.append({"capture": folder.name, "error": str(error)})
                continue
        answers.append(_answer(folder.name, target))
    text = json.dumps(answers, indent=1)
    path = out / "answers.json"
    path.write_text(json.dumps({"sha256": _digest(text, ""), "answers": answers}, indent=1) + "\n", encoding="utf-8")
    return path


def _answer(name: str, folder: Path) -> dict[str, Any]:
    content = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    which, how_far = content["which"], content["how_far"]
    material = {row["name"]: row for row in how_far["parameters"]}
    fits = [h["effects"] for h in which["hypotheses"] if h["effects"]]
    return {
        "capture": name,
        "verdict": which["verdict"],
        "effects": [{k: e[k] for k in ("name", "variant", "probability", "parameters", "confused_with")}
                    for e in which["effects"]],
        "ranking": fits,
        "shrinkage": how_far["shrinkage"],
        "placebo": how_far["placebo"],
        "gap_before": how_far["gap_before"],
        "gap_after": how_far["gap_after"],
        "noise_floor": how_far["noise_floor"],
        "visibility": how_far["gap_before"] / max(how_far["noise_floor"], 1e-300),
        "log10_youngs_modulus": [material[n][k] for n in ("log10_youngs_modulus",) for k in ("before", "after")],
        "poisson_ratio": [material[n][k] for n in ("poisson_ratio",) for k in ("before", "after")],
        "seconds": content["provenance"]["seconds"],
    }  # fmt: skip


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
    rows: tuple[dict[str, Any], ...]


def same_class(first: str, second: str) -> bool:
    """Equal, or in one declared confusion class."""
    return first == second or any({first, second} <= group for group in CONFUSION_CLASSES)


def score_bank(captures: Path, seal: Path, answers: Path) -> BankScore:
    """Open the seal and compare.

    Raises:
        InputError: the seal does not belong to the captures, or the answers were changed after they were hashed.
    """
    sealed = json.loads(seal.read_text(encoding="utf-8"))
    commitment = json.loads((captures / COMMITMENT).read_text(encoding="utf-8"))
    if _digest(sealed["labels"], sealed["salt"]) != commitment["sha256"]:
        raise InputError(f"{seal}: its hash differs from {captures / COMMITMENT}; it belongs to other captures")
    given = json.loads(answers.read_text(encoding="utf-8"))
    if _digest(json.dumps(given["answers"], indent=1), "") != given["sha256"]:
        raise InputError(f"{answers}: its hash differs from its content; the answers were changed")
    by_name = {answer["capture"]: answer for answer in given["answers"]}
    rows = [_row(label, by_name.get(label["capture"])) for label in json.loads(sealed["labels"])]
    answered = [row for row in rows if row["verdict"] is not None]
    outside = [row for row in answered if set(row["truth"]) & set(OUTSIDE)]
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
        rows=tuple(rows),
    )


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
