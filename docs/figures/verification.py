"""Compute the numbers of docs/results/physics.md (docs/results/data/verification.json) and draw its figures.

Run from the root of the repository: python -m docs.figures.verification [--draw-only]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from docs.figures.fem_cases import beams, contact, convergence, measured, tolerance
from docs.figures.verification_plots import draw_all

DOCS = Path(__file__).parents[1]
RESULT = DOCS / "results" / "data" / "verification.json"
COMMAND = "python -m docs.figures.verification"


def convergence_numbers() -> dict[str, Any]:
    """Errors and fitted orders in space and time."""
    space = [convergence.in_space(1, (2, 4, 8, 16)), convergence.in_space(2, (2, 4, 6, 8))]
    times = [
        convergence.in_time("implicit_euler", (100, 200, 400, 800)),
        convergence.in_time("bdf2", (50, 100, 200, 400)),
    ]
    return {
        kind: [asdict(run) | {"slopes": run.slopes()} for run in runs]
        for kind, runs in (("space", space), ("time", times))
    }


def beam_numbers() -> dict[str, Any]:
    """Beam theory, Cook's membrane, modes, Kaolin's beam."""
    classical = {"at": 52.0, "youngs_modulus": 1.0, "traction": 1 / 16}
    kaolin = [("neo_hookean_log", (12, 3, 3)), ("neo_hookean", (12, 3, 3)), ("neo_hookean_log", (16, 4, 4))]
    return {
        "cantilever": [asdict(beams.cantilever(s)) for s in (2, 4, 8, 16, 32)],
        "cantilever_linear": [asdict(beams.cantilever(s, order=1)) for s in (2, 4, 8, 16, 32)],
        "cook_strain_mm": 1e3 * beams.cook_membrane(20, plane="strain"),
        "cook_stress": 1e3 * beams.cook_membrane(20, plane="stress", **classical),
        "cube_hz": beams.free_cube_frequencies(5).tolist(),
        "modes_045_hz": beams.silicone_frequencies(0.45, (14, 4, 4)).tolist(),
        "modes_0499_hz": beams.silicone_frequencies(0.499, (14, 4, 4)).tolist(),
        "kaolin": [asdict(beams.kaolin_beam(law, cells)) for law, cells in (*kaolin, ("stvk", (10, 3, 3)))],
    }


def silicone_numbers() -> dict[str, Any]:
    """The silicone beam at rest on three meshes, in millimetres (points × axes)."""
    rows = []
    for cells in ((10, 3, 3), (14, 4, 4), (16, 5, 5)):
        body = beams.silicone_beam(cells)
        row: dict[str, Any] = {"cells": cells, "nodes": len(body.mesh.vertices)}
        row["gravity"] = (1e3 * beams.silicone_sag(body)).tolist()
        row["edge"] = (1e3 * beams.silicone_sag(body, load=measured.LOAD)).tolist()
        row["face"] = (1e3 * beams.silicone_sag(body, load=measured.LOAD, where="face")).tolist()
        rows.append(row)
    return {"meshes": rows}


def measured_numbers() -> dict[str, Any]:
    """Measured beam: sag, frequencies, and the tracks of the figure [mm]."""
    body = beams.silicone_beam((14, 4, 4))
    cases: dict[str, Any] = {"zero_scatter_mm": 1e3 * measured.held_zero_scatter()}
    for name, load in (("gravity", 0.0), ("load101", measured.LOAD)):
        run, state = measured.recording(name), measured.static_state(body, load)
        frame, rest = run.release_frame, run.at_rest(run.tips)[:, 2].mean()
        heights = run.tips[frame:, :, 2].mean(1)
        cases[name] = {
            "measured_sag_mm": (1e3 * run.sag()).tolist(),
            "simulated_sag_mm": (1e3 * measured.marker_displacement(body, state)).tolist(),
            "measured_hz": measured.oscillation_frequency(run.times[frame:], heights, rest),
            "simulated_hz": measured.first_frequency(body, state, tip_mass=load / 9.80709),
        }
    run = measured.recording("gravity")
    start = run.release_frame - 1
    fall = measured.release(beams.silicone_beam((10, 3, 3)), seconds=1.0, damping_time=2.4e-3, steps_per_frame=8)
    window = slice(start, start + 101)
    cases["release"] = {
        "damping_time_s": 2.4e-3,
        "times_s": fall.times.tolist(),
        "simulated_mm": (1e3 * fall.markers[:, :, 2].mean(1)).tolist(),
        "measured_mm": (1e3 * (run.tips[window] - run.held(run.tips))[:, :, 2].mean(1)).tolist(),
    }
    return cases


def contact_numbers() -> dict[str, Any]:
    """Slopes and impacts."""
    impacts = [(friction, modulus, passes) for friction in (0.2, 0.5) for modulus in (1e5, 1e6) for passes in (2, 12)]
    return {
        "slope": asdict(contact.slope((5, 10, 15, 20, 25, 28, 30, 35, 40, 45))),
        "impacts": [asdict(contact.impact(modulus, passes=n, friction=friction)) for friction, modulus, n in impacts],
    }


def tolerance_numbers() -> dict[str, Any]:
    """Newton's tolerance against accuracy."""
    rows = [row for modulus in (1e5, 1e6, 1e7) for row in tolerance.flight(modulus, (1e-6, 1e-7, 1e-8, 1e-9))]
    return {"flight": [asdict(row) for row in rows]}


PARTS: dict[str, Callable[[], dict[str, Any]]] = {
    "convergence": convergence_numbers,
    "beams": beam_numbers,
    "silicone": silicone_numbers,
    "measured": measured_numbers,
    "contact": contact_numbers,
    "tolerance": tolerance_numbers,
}


def main() -> None:
    """Compute, store, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draw-only", action="store_true", help="draw from the stored numbers")
    if not parser.parse_args().draw_only:
        torch.set_num_threads(1)
        content: dict[str, Any] = {"command": COMMAND, "numpy": np.__version__, "torch": torch.__version__}
        for name, compute in PARTS.items():
            clock = time.perf_counter()
            content[name] = compute()
            print(f"{name}: {time.perf_counter() - clock:.0f} s", flush=True)
        RESULT.parent.mkdir(parents=True, exist_ok=True)
        RESULT.write_text(json.dumps(content, indent=1))
    for path in draw_all(json.loads(RESULT.read_text()), DOCS / "images"):
        print(path)


if __name__ == "__main__":
    main()
