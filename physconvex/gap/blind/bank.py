"""Blind test of the diagnosis: captures whose labels are sealed, and answers."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from physconvex.capture import load_capture, save_capture
from physconvex.errors import ConvergenceError, InputError, PhysconvexError
from physconvex.gap.blind.cases import BLIND_EFFECTS, Case, capture_parts, draw_case, kinds_for, simulate_case
from physconvex.gap.blind.classes import same_class
from physconvex.gap.blind.controls import CONTROLS, Control
from physconvex.gap.blind.explicit_cases import EXPLICIT_EFFECTS, OUTSIDE, simulate_explicit
from physconvex.gap.diagnose import diagnose
from physconvex.gap.options import GapOptions

__all__ = ["COMMITMENT", "EngineName", "diagnose_bank", "digest", "generate_bank"]

COMMITMENT = "commitment.json"
Report = Callable[[str], None]
EngineName = Literal["explicit", "fem"]


def digest(text: str, salt: str) -> str:
    """SHA-256 of the salt and a text."""
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
    controls: Sequence[str] = (),
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
        controls: names of controls (`physconvex.gap.blind.controls`), one more capture for each.
        report: told what is done.

    Returns:
        Number of captures, controls included; draws whose simulation fails are drawn anew.

    Raises:
        InputError: a folder or file exists already, or an unknown effect.
    """
    known = EXPLICIT_EFFECTS if engine == "explicit" else BLIND_EFFECTS
    names = list(known if effects is None else effects)
    unknown = set(names) - set(known)
    if unknown:
        raise InputError(f"effects: got {sorted(unknown)}; expected names among {', '.join(known)}")
    if set(controls) - set(CONTROLS) or ("noise" in controls and not count):
        raise InputError(
            f"controls: got {', '.join(controls)}; expected names among {', '.join(CONTROLS)}, `noise` beside a capture"
        )
    for path in (out, seal):
        if path.exists():
            raise InputError(f"{path}: exists; choose another place for a new bank")
    out.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    plan = _plan(rng, count, names, {"free": effect_free, "two": two, "outside": outside})
    jobs: list[tuple[tuple[str, ...], Control | None]] = [(hidden, None) for hidden in plan]
    jobs += [(CONTROLS[name].effects, CONTROLS[name]) for name in controls]
    labels: list[dict[str, Any]] = []
    drawn: list[Case] = []
    for number, (hidden, control) in enumerate(jobs):
        name = f"capture_{number:03d}"
        report(name)
        visibility = float(visibilities[number % len(visibilities)])
        if control is not None and control.repeats:
            original = next((i for i, names in enumerate(plan) if names), 0)
            _repeated(out / name, out / labels[original]["capture"], drawn[original])
            labels.append(labels[original] | {"capture": name, "control": control.name,
                                              "repeats": labels[original]["capture"]})  # fmt: skip
            continue
        case, seen = _written(out / name, hidden, rng, engine, visibility, control)
        drawn.append(case)
        labels.append({"capture": name, "kind": case.kind, "seed": case.seed, "youngs_modulus": case.youngs_modulus,
                       "poisson_ratio": case.poisson_ratio, "engine": engine, "visibility": seen,
                       "control": None if control is None else control.name,
                       "effects": [asdict(h) for h in case.hidden]})  # fmt: skip
    text = json.dumps(labels, indent=1)
    salt = secrets.token_hex(16)
    seal.parent.mkdir(parents=True, exist_ok=True)
    seal.write_text(json.dumps({"salt": salt, "labels": text}) + "\n", encoding="utf-8")
    commitment = {"sha256": digest(text, salt), "captures": len(labels), "hashed": "salt + labels"}
    (out / COMMITMENT).write_text(json.dumps(commitment, indent=1) + "\n", encoding="utf-8")
    return len(labels)


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
    folder: Path, names: tuple[str, ...], rng: np.random.Generator, engine: EngineName, visibility: float,
    control: Control | None = None,
) -> tuple[Case, float]:  # fmt: skip
    for _ in range(20):
        case, seen = draw_case(int(rng.integers(2**31)), names, dosed=engine == "fem"), float("nan")
        try:
            if engine == "fem":
                motion, positions = simulate_case(case)
            else:
                motion, positions, case, seen = simulate_explicit(
                    case, names, visibility, rough=control is not None and control.rough
                )
        except (ConvergenceError, InputError):
            continue
        if not np.isfinite(positions).all():
            continue
        capture, parts = capture_parts(case, positions, motion.rest, folder)
        if control is not None:
            capture = replace(capture, density=control.density * capture.density)
        save_capture(capture, **parts)
        return case, seen
    raise ConvergenceError(f"{folder.name}: twenty draws could not be simulated")


def _repeated(folder: Path, original: Path, case: Case) -> None:
    """The same take with new noise."""
    capture = load_capture(original)
    tracks, mesh = capture.tracks(), capture.mesh()
    assert tracks is not None and mesh is not None
    old = case.noise * np.random.default_rng([case.seed, 2]).normal(size=tracks.positions.shape)
    new = case.noise * np.random.default_rng([case.seed, 3]).normal(size=tracks.positions.shape)
    parts: dict[str, Any] = {"mesh": mesh, "tracks": replace(tracks, positions=tracks.positions - old + new)}
    if capture.boundary() is not None:
        parts["boundary"] = capture.boundary()
    save_capture(replace(capture, folder=folder), **parts)


def diagnose_bank(
    captures: Path, out: Path, *, without: Sequence[str] = (), options: GapOptions | None = None,
    report: Report = lambda _: None,
) -> Path:  # fmt: skip
    """Diagnose every capture of a bank and write answers.json; captures that have an answer are left.

    Args:
        captures: folder of the captures.
        out: folder of the reports.
        without: effects that are taken out of the dictionary; captures that hide one count as `outside`.
        options: settings.
        report: told what is done.

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
                diagnose(folder, without=without, options=options).save(target)
            except PhysconvexError as error:
                target.mkdir(parents=True, exist_ok=True)
                (target / "error.txt").write_text(f"{error}\n", encoding="utf-8")
                answers.append({"capture": folder.name, "error": str(error)})
                continue
        answers.append(_answer(folder.name, target))
    text = json.dumps(answers, indent=1)
    path = out / "answers.json"
    path.write_text(
        json.dumps({"sha256": digest(text, ""), "without": list(without), "answers": answers}, indent=1) + "\n",
        encoding="utf-8",
    )
    return path


def _answer(name: str, folder: Path) -> dict[str, Any]:
    content = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    which, how_far = content["which"], content["how_far"]
    material = {row["name"]: row for row in how_far["parameters"]}
    fits = [h["effects"] for h in which["hypotheses"] if h["effects"]]
    return {
        "capture": name,
        "verdict": which["verdict"],
        "effects": [{k: e[k] for k in ("name", "variant", "source", "probability", "parameters", "confused_with")}
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
