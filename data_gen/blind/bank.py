"""A bank of captures with sealed labels."""

from __future__ import annotations

import hashlib
import json
import secrets
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from data_gen.blind.cases import BLIND_EFFECTS, Case, capture_parts, draw_case, simulate_case
from data_gen.blind.explicit_cases import EXPLICIT_EFFECTS, simulate_explicit
from data_gen.blind.plan import Planned, Shares, plan_bank
from data_gen.engines import run_jobs
from physconvex import ConvergenceError, InputError
from physconvex.io import CommandLine, Options, load_capture, save_capture

COMMITMENT = "commitment.json"
DICTIONARY = "dictionary.json"
Report = Callable[[str], None]
EngineName = Literal["explicit", "fem"]
_DRAWS = 8  # attempts per capture


def digest(text: str, salt: str) -> str:
    """SHA-256 of the salt and a text."""
    return hashlib.sha256((salt + text).encode()).hexdigest()


class BankOptions(Options):
    """Contents of a bank of captures."""

    count: Annotated[int, Field(ge=0)] = 16
    """Number of captures."""
    seed: int = 0
    """Seed of everything random."""
    effects: Annotated[tuple[str, ...], CommandLine(commas=True)] = ()
    """Effects to draw from, separated by commas. Default: all that the simulator knows."""
    shares: Shares = Shares()
    controls: Annotated[tuple[str, ...], CommandLine(commas=True)] = ()
    """Controls, each an additional capture: density, numerics, camera, noise; separated by commas."""
    visibilities: Annotated[tuple[float, ...], CommandLine(commas=True)] = (10.0,)
    """Mean square of the gap over that of noise and numerical error, separated by commas; the captures take turns.
    Default: 10."""
    engine: EngineName = "explicit"
    """Simulator: explicit (independent, doses scaled to the visibility) or fem (the full-order model on another mesh,
    doses by size)."""
    workers: Annotated[int, Field(ge=1)] = 1
    """Worker processes."""


def generate_bank(out: Path, seal: Path, options: BankOptions | None = None, *, report: Report = lambda _: None) -> int:
    """Write captures into `out`, their labels into the file `seal`, and the hash of the labels beside the captures.

    Each capture is drawn from the seed and its number, so the bank does not depend on the number of processes. Labels
    lie in a folder beside the seal (its name and `.parts`) while the bank is incomplete; the same call resumes an
    interrupted run. `dictionary.json` lists captures that are diagnosed without some effects.

    Args:
        out: folder of the captures.
        seal: file of the labels; hide it from whoever diagnoses.
        options: contents of the bank.
        report: receives progress messages.

    Returns:
        Number of captures, controls included. A draw whose simulation fails is repeated, up to eight draws in all. If
        all fail, the capture is left out and its label says so.

    Raises:
        InputError: the bank exists, a bank with other settings is begun there, or an effect is unknown.
    """
    options = options or BankOptions()
    engine, seed, workers = options.engine, options.seed, options.workers
    known = EXPLICIT_EFFECTS if engine == "explicit" else BLIND_EFFECTS
    names = list(options.effects or known)
    unknown = set(names) - set(known)
    if unknown:
        raise InputError(f"effects: got {sorted(unknown)}; expected names among {', '.join(known)}")
    plan = plan_bank(seed, options.count, names, options.visibilities, shares=options.shares, controls=options.controls)
    parts = seal.with_name(seal.name + ".parts")
    _begin(out, seal, parts, json.dumps({"seed": seed, "engine": engine, "plan": [asdict(p) for p in plan]}))
    jobs = [_Job(number, planned, seed, engine, out, parts) for number, planned in enumerate(plan)]
    todo = [job for job in jobs if not job.label.exists()]
    for repeats in (False, True):  # a capture that repeats another one needs that one first
        calls = {job.name: partial(_make, job) for job in todo if job.planned.repeats == repeats}
        run_jobs(calls, workers=1 if repeats else workers, report=report)
    labels = [json.loads(job.label.read_text(encoding="utf-8")) for job in jobs]
    text, salt = json.dumps(labels, indent=1), secrets.token_hex(16)
    without = {job.name: list(job.planned.without) for job in jobs}
    asked = {label["capture"]: without[label.get("repeats", label["capture"])] for label in labels}
    deleted = {name: names for name, names in asked.items() if names}
    (out / DICTIONARY).write_text(json.dumps(deleted, indent=1) + "\n", encoding="utf-8")
    commitment = {"sha256": digest(text, salt), "captures": len(labels), "hashed": "salt + labels"}
    (out / COMMITMENT).write_text(json.dumps(commitment, indent=1) + "\n", encoding="utf-8")
    seal.write_text(json.dumps({"salt": salt, "labels": text}) + "\n", encoding="utf-8")
    shutil.rmtree(parts)
    return sum("failed" not in label for label in labels)


def _begin(out: Path, seal: Path, parts: Path, settings: str) -> None:
    """Make the folders, or check that they belong to an unfinished bank with these settings."""
    begun = parts / "settings.json"
    if begun.exists():
        if begun.read_text(encoding="utf-8") != settings:
            raise InputError(f"{parts}: a bank with other settings was begun here; choose another place or remove it")
        return
    for path in (out, seal):
        if path.exists():
            raise InputError(f"{path}: exists; choose another place for a new bank")
    out.mkdir(parents=True)
    parts.mkdir(parents=True)
    begun.write_text(settings, encoding="utf-8")


@dataclass(frozen=True)
class _Job:
    """One capture and its destination."""

    number: int
    planned: Planned
    seed: int
    engine: EngineName
    out: Path
    parts: Path

    @property
    def name(self) -> str:
        return _name(self.number)

    @property
    def label(self) -> Path:
        return self.parts / f"{self.name}.json"


def _name(number: int) -> str:
    return f"capture_{number:03d}"


def _make(job: _Job) -> None:
    """Write a capture, then its label."""
    planned, control = job.planned, job.planned.control
    label: dict[str, Any] = {"planned": planned.effects}
    try:
        label |= _repeated(job) if planned.repeats else _drawn(job)
    except ConvergenceError as error:
        label |= {"failed": str(error), "effects": []}
    label |= {"capture": job.name, "control": control and control.name}
    whole = job.label.with_suffix(".tmp")
    whole.write_text(json.dumps(label), encoding="utf-8")
    whole.replace(job.label)


def _drawn(job: _Job) -> dict[str, Any]:
    """Draw and write a capture; return the entries of its label."""
    case, seen = _written(job)
    return {
        "kind": case.kind, "seed": case.seed, "youngs_modulus": case.youngs_modulus,
        "poisson_ratio": case.poisson_ratio, "engine": job.engine, "wanted": job.planned.visibility,
        "visibility": seen, "effects": [asdict(h) for h in case.hidden],
    }  # fmt: skip


def _written(job: _Job) -> tuple[Case, float]:
    planned, control, folder = job.planned, job.planned.control, job.out / job.name
    rng, names = np.random.default_rng([job.seed, 1, job.number]), planned.effects
    for _ in range(_DRAWS):
        case, seen = draw_case(int(rng.integers(2**31)), names, dosed=job.engine == "fem"), float("nan")
        try:
            if job.engine == "fem":
                motion, positions = simulate_case(case)
            else:
                motion, positions, case, seen = simulate_explicit(
                    case, names, planned.visibility, rough=control is not None and control.rough
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
    raise ConvergenceError(f"{folder.name}: {_DRAWS} draws could not be simulated")


def _repeated(job: _Job) -> dict[str, Any]:
    """Write an earlier capture with new noise: the first one with a hidden effect, if there is one."""
    labels = [json.loads((job.parts / f"{_name(k)}.json").read_text(encoding="utf-8")) for k in range(job.number)]
    drawn = [label for label in labels if "failed" not in label and label["control"] is None]
    if not drawn:
        raise ConvergenceError(f"{job.name}: no capture was drawn that it could repeat")
    original = next((label for label in drawn if label["effects"]), drawn[0])
    capture = load_capture(job.out / original["capture"])
    tracks, mesh = capture.tracks(), capture.mesh()
    assert tracks is not None and mesh is not None
    sigma = tracks.sigma[..., None]
    old, new = (
        sigma * np.random.default_rng([original["seed"], take]).normal(size=tracks.positions.shape) for take in (2, 3)
    )
    parts: dict[str, Any] = {"mesh": mesh, "tracks": replace(tracks, positions=tracks.positions - old + new)}
    if capture.boundary() is not None:
        parts["boundary"] = capture.boundary()
    save_capture(replace(capture, folder=job.out / job.name), **parts)
    return original | {"repeats": original["capture"]}
