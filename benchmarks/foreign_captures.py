"""Captures that this package did not simulate: their files, and what `physconvex diagnose` says of each, as JSON."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from physconvex import PhysconvexError
from physconvex.gap import (
    GapOptions,
    correction_of,
    diagnose,
    error_model,
    find_setting,
    fit_baseline,
    numerical_differences,
    rough_baseline,
)
from physconvex.io import Boundary, Floor, Tracks, load_capture
from physconvex.mesh import TetMesh

RESULTS = Path(__file__).parent / "results"
FLOOR = Floor(np.zeros(3), np.array([0.0, 0.0, 1.0]))
HELD = Boundary(clamped_box=np.array([[-1e-4, -1.0, -1.0], [1e-4, 1.0, 1.0]]))  # at x = 0


def markers(mesh: TetMesh, trajectory: np.ndarray, name: str, count: int, sigma: float, beyond: float = 0.0) -> Tracks:
    """So many nodes of the surface, drawn by the case's name, with noise.

    Args:
        mesh: at t = 0.
        trajectory: nodes at the frames [m], shape [T, V, 3].
        name: of the case.
        count: of the markers.
        sigma: of the noise [m].
        beyond: those nearer to x = 0 are left out [m]; 0 where nothing is held.
    """
    rng = np.random.default_rng(sum(map(ord, name)))
    outer = np.unique(mesh.boundary_faces[:, :3])
    if beyond:
        outer = outer[mesh.vertices[outer, 0] > beyond]
    seen = rng.choice(outer, count, replace=False)
    positions = trajectory[:, seen] + sigma * rng.normal(size=(len(trajectory), count, 3))
    return Tracks(mesh.vertices[seen], positions, np.full(positions.shape[:2], sigma))


def answer(folder: Path, out: Path) -> dict[str, object]:
    """Of the diagnosis with default settings, gaps in metres on held-out frames; its report is put into `out`."""
    try:
        report = diagnose(folder)
    except PhysconvexError as error:
        return {"error": str(error)}
    report.save(out)
    main = report.how_far[0]
    return {
        "verdict": report.verdict.name,
        "sentence": report.verdict.sentence,
        "effects": {e.name: {d.name: d.value for d in e.doses} for e in report.verdict.effects},
        "base_parameters": {p.name: [p.before, p.after] for p in report.parameters},
        "caveats": list(report.verdict.caveats),
        "ranking": [list(h.names) for h in report.hypotheses],
        "gap": [main.gap_before, main.gap_after, main.noise_floor],
        "shrinkage": main.shrinkage,
        "shrinkage_by_data": {part.data: part.shrinkage for part in report.how_far},
        "interval": [main.lower, main.upper],
        "placebo": main.placebo if np.isfinite(main.placebo) else None,
        "seconds": report.provenance.seconds,
    }


def base_fit(folder: Path) -> dict[str, object]:
    """Of the base model alone, before any effect is tried."""
    options, silent = GapOptions(), lambda text: None
    rough = find_setting(rough_baseline(load_capture(folder), options, silent), options, silent).base
    numerics = numerical_differences(rough, options, silent)
    variance = error_model(rough, numerics, options).variance
    base = fit_baseline(rough, correction_of(numerics), numerics.fine, variance, options=options, report=silent)
    return {
        "base_parameters": dict(zip(base.model.base, base.fit.values.tolist(), strict=True)),
        "rms_in_standard_deviations": float(np.sqrt(np.mean(base.residual(base.positions) ** 2))),
    }


def store(result: Path, name: str, found: dict[str, object]) -> None:
    """Put the answer of one case into a file of results, beside those of others."""
    content = json.loads(result.read_text(encoding="utf-8")) if result.exists() else {"cases": {}}
    content["cases"][name] = found
    result.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def run(description: str | None, cases: Sequence[str], write: Callable[[Path, str], None], result: Path) -> None:
    """Every case that the command line asks for: its capture, then the answer.

    Args:
        description: of the script.
        cases: names.
        write: of a capture, given its folder and the name.
        result: JSON file of the answers; those of other cases are kept.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", default=",".join(cases))
    parser.add_argument("--captures-only", action="store_true")
    parser.add_argument("--base-only", action="store_true", help="fit the base model alone")
    arguments = parser.parse_args()
    for name in arguments.cases.split(","):
        folder = arguments.out / "captures" / name
        if not (folder / "capture.json").exists():
            write(folder, name)
        if arguments.base_only:
            print(json.dumps({"hidden": name} | base_fit(folder)), flush=True)
        elif not arguments.captures_only:
            found = answer(folder, arguments.out / "answers" / name)
            store(result, name, found)
            print(json.dumps({"hidden": name} | found), flush=True)
