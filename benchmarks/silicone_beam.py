"""E and damping of the measured silicone beam (Dubied et al. 2022), from its free oscillation and from its sag.

PYTHONPATH=. python benchmarks/silicone_beam.py

Builds a capture folder from the recording under its own weight (six-marker motion capture, tests/data), refines it, and
compares with the authors' constants, which were themselves fitted to recordings of this beam. What the recording does
not say is treated as unknown: damping, and how high the beam was held when it was let go (±1.5 mm between recordings).
The instant of release lies somewhere within a frame: several are tried, and the best is kept.
"""

from __future__ import annotations

import argparse
import json
import shlex
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from docs.figures.fem_cases.beam_capture import beam_capture
from docs.figures.fem_cases.beams import silicone_beam
from docs.figures.fem_cases.measured import (
    LOAD,
    held_zero_scatter,
    marker_displacement,
    recording,
    static_state,
)
from inference import RefineOptions, refine, write_refinement
from physconvex.fem import ElasticBody

RESULT = Path(__file__).parent / "results" / "silicone_beam.json"
AUTHORS = {"youngs_modulus": 263824.0, "poisson_ratio": 0.499}
FRAMES, OBSERVED, CELLS = 40, 20, (8, 2, 2)
OFFSETS_MS = [-2.5, -5.0, 0.0]  # instants of release, after the first frame that moves
HELD = {"initial_position_z": (0.015, 1.5e-3)}  # prior: how high the middle of the beam was held [m]
START = {"log10_youngs_modulus": 5.35}


@dataclass(frozen=True)
class StaticFit:
    """E [Pa] whose sag is that of a recording, and the range that the scatter of the held zero allows."""

    load_newton: float
    sag_mm: float
    youngs_modulus: float
    lowest: float
    highest: float


def static_fit(name: str, load: float, poisson_ratio: float) -> StaticFit:
    """From the mean sag of the tip markers."""
    sag = float(recording(name).sag()[:, 2].mean())
    # log sag is nearly linear in log E: three states and a parabola through them
    logs, sags = np.array([5.25, 5.4, 5.55]), []
    mesh = silicone_beam(CELLS).mesh
    for log in logs:
        body = ElasticBody(mesh, youngs_modulus=10**log, poisson_ratio=poisson_ratio, density=1070.0)
        sags.append(float(marker_displacement(body, static_state(body, load))[:, 2].mean()))
    curve = np.polyfit(np.log(-np.array(sags)), logs, 2)

    def modulus(target: float) -> float:
        return float(10 ** np.polyval(curve, np.log(-target)))

    zero = held_zero_scatter()
    return StaticFit(load, 1e3 * sag, modulus(sag), modulus(sag - zero), modulus(sag + zero))


def options(ratio: float, **changes: object) -> RefineOptions:
    """Free: E, damping, and the height at which the beam was held."""
    settings = {
        "fixed": {"poisson_ratio": ratio},
        "free": tuple(HELD),
        "priors": HELD,
        "start": "scan",
        "weights": 6,
        "full_runs": 3,
        "jacobian": "reduced",  # as when the stored result was made
        "model_error": False,
    }
    return RefineOptions(**(settings | changes))  # type: ignore[arg-type]


def best_offset(root: Path, offsets: list[float], ratio: float) -> tuple[float, dict[str, float], dict[str, float]]:
    """The instant of release with the smallest misfit of the reduced model, all misfits, and a start for the rest."""
    misfits, first = {}, START
    for offset in offsets:
        folder = root / f"capture_{offset:+.1f}ms"
        if not folder.exists():
            beam_capture(folder, "gravity", frames=FRAMES, observed=OBSERVED, offset_ms=offset, cells=CELLS)
        chosen = options(ratio, correction=False, initial=first)
        found = refine(folder, out=root / f"reduced_{offset:+.1f}ms", options=chosen)
        first = {e.name: e.value for e in found.estimates}
        misfits[f"{offset:+.1f}"] = found.history[-1].misfit
        print(offset, found.history[-1].misfit, found.youngs_modulus, found.poisson_ratio, flush=True)
    return float(min(misfits, key=lambda key: misfits[key])), misfits, first


def arguments_of(arguments: argparse.Namespace) -> list[str]:
    """The options that decide the result, as given on the command line."""
    return ["--offsets", *map(str, arguments.offsets), "--ratios", *map(str, arguments.ratios)]


def main() -> None:
    """Run and store."""
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--offsets", type=float, nargs="+", default=OFFSETS_MS, help="instants of release [ms]")
    parser.add_argument("--ratios", type=float, nargs="+", default=[0.45, 0.49], help="ν of the fits")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "silicone_beam")
    arguments = parser.parse_args()
    root, ratios = arguments.work, arguments.ratios
    root.mkdir(parents=True, exist_ok=True)
    clock = time.process_time()
    offset, misfits, first = best_offset(root, arguments.offsets, ratios[0])
    dynamic = []
    for ratio in ratios:
        chosen, out = options(ratio, initial=first), root / f"refined_{ratio}"
        found = refine(root / f"capture_{offset:+.1f}ms", out=out, options=chosen)
        write_refinement(found, out, options=chosen)
        first = {e.name: e.value for e in found.estimates}
        dynamic.append({k: v for k, v in found.to_json().items() if k not in ("history", "path")})
        print(ratio, found.youngs_modulus, found.reduced_chi_square, flush=True)
    statics = [asdict(static_fit(name, load, 0.495)) for name, load in (("gravity", 0.0), ("load101", LOAD))]
    result = {
        "command": "PYTHONPATH=. " + shlex.join(["python", "benchmarks/silicone_beam.py", *arguments_of(arguments)]),
        "authors": AUTHORS,
        "held_zero_scatter_mm": 1e3 * held_zero_scatter(),
        "release_offsets_ms": misfits,
        "dynamic": dynamic,
        "static": statics,
        "process_seconds": round(time.process_time() - clock, 1),
    }
    RESULT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(statics, indent=1))


if __name__ == "__main__":
    main()
