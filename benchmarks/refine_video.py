"""Refinement from videos: |Δlog10 E|, |Δν| and coverage of the 90 % intervals over textured bodies that fall.

python benchmarks/refine_video.py --cases 6          (goes on where it stopped)

Bodies of the generator, dropped on a rough floor, 224² pixels, 18 frames at 24 per second of which 12 are fitted, from
--cameras cameras around (the capture has two). E is drawn log-uniform, ν uniform, damping too. The rest geometry is
the generator's own mesh (at most 300 nodes) and truth was made on it with twice the time steps, landing on the shown
surface as the twin does, so that this measures what the images and the search lose, and no difference of meshes. The
constant predictor says the middle of both ranges.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from data_gen import RingOptions, capture_folder, generate_captures, load_config
from inference import Refinement, RefineOptions, refine

RESULT = Path(__file__).parent / "results" / "refine_video.json"
MODULUS, RATIO = (4.3, 5.7), (0.2, 0.45)
CONFIG = [
    "video={frames: 18, width: 224, height: 224, supersampling: 2}",
    "solver={target_nodes: 300, landing_nodes: 0, steps_per_frame: 32, touching: surface}",
    "camera.views=2",
    "motion.drop_height=[0.2, 0.4]",
    "motion.size=[1.0,1.0]",
    "motion.initial_spin=[0.0,0.6]",
    f"material.youngs_modulus=[{10 ** MODULUS[0]:.6g},{10 ** MODULUS[1]:.6g}]",
    f"material.poisson_ratio=[{RATIO[0]},{RATIO[1]}]",
    "material.damping_time=[5e-4,2e-3]",
    "samples={points: 8, modes: 2}",
]
NAMES = ("log10_youngs_modulus", "poisson_ratio")


def options(cameras: int) -> RefineOptions:
    """Of the refinement."""
    names = tuple(f"camera{k}" for k in range(cameras))
    return RefineOptions(observations="video", cameras=names, weights=6, max_nodes=300, start="scan", model_error=False)


def row_of(case: int, truth: dict[str, Any], found: Refinement, seconds: float) -> dict[str, Any]:
    """Errors (fit less truth) of the reduced model, of the full one on followed points, and of the last fit."""
    true = {"log10_youngs_modulus": float(np.log10(truth["youngs_modulus"])), "poisson_ratio": truth["poisson_ratio"]}
    order = [e.name for e in found.estimates]
    places = [order.index(name) for name in NAMES]
    wanted = np.array([true[name] for name in NAMES])
    intervals = [found[name].interval for name in NAMES]
    return {
        "case": case,
        "family": truth["family"],
        **true,
        "damping_time": truth["damping_time"],
        "reduced_error": (found.reduced_values[places] - wanted).tolist(),
        "points_error": (found.full_runs[-1].values[places] - wanted).tolist(),
        "error": [found[name].value - true[name] for name in NAMES],
        "sigma": [found[name].noise_sigma for name in NAMES],
        "covered": [None if i is None else bool(i[0] <= w <= i[1]) for i, w in zip(intervals, wanted, strict=True)],
        "reduced_chi_square": found.reduced_chi_square,
        "residual_rms": found.residual_rms,
        "converged": found.converged,
        "in_words": [*found.identifiability.sentences, *found.warnings],
        "process_seconds": round(seconds, 1),
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Means of the absolute errors [log10 E, ν], beside the constant guess; coverage."""
    good = [row for row in rows if "error" in row]
    if not good:
        return {"captures": 0, "failures": len(rows)}
    out: dict[str, Any] = {"captures": len(good), "failures": len(rows) - len(good)}
    for name in ("reduced_error", "points_error", "error"):
        values = np.abs([row[name] for row in good])
        out[f"mean_{name}"], out[f"median_{name}"] = values.mean(0).tolist(), np.median(values, axis=0).tolist()
    middle = np.array([np.mean(MODULUS), np.mean(RATIO)])
    out["constant_error"] = np.abs([[row[n] for n in NAMES] - middle for row in good]).mean(0).tolist()
    covered = [c for row in good for c in row["covered"] if c is not None]
    out["coverage_90"], out["intervals"] = (float(np.mean(covered)) if covered else None), len(covered)
    out["mean_process_seconds"] = float(np.mean([row["process_seconds"] for row in good]))
    return out


def measure(root: Path, case: int, cameras: int) -> dict[str, Any]:
    """Refine one capture; what failed is named."""
    folder = capture_folder(root / "captures", case)
    truth = json.loads((folder / "truth.json").read_text())
    clock = time.process_time()
    try:
        found = refine(folder, out=root / f"refined_{cameras}" / folder.name, options=options(cameras))
    except Exception as error:  # a failure is a result here
        return {"case": case, "family": truth["family"], "failure": f"{type(error).__name__}: {error}"}
    return row_of(case, truth, found, time.process_time() - clock)


def main() -> None:
    """Run the cases that are not there yet, and store the table after each."""
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=6)
    parser.add_argument("--cameras", type=int, default=1)
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "refine_video")
    given = parser.parse_args()
    rings = RingOptions(observed_frames=12, markers=25, marker_noise=1e-3)
    config = load_config("captures", overrides=CONFIG)
    rows = []
    for case in range(given.cases):
        generate_captures(given.work / "captures", count=case + 1, config=config, seed=5, options=rings)
        kept = given.work / f"row_{given.cameras}_{case:03d}.json"
        if not kept.exists():
            kept.write_text(json.dumps(measure(given.work, case, given.cameras)))
        rows.append(json.loads(kept.read_text()))
        print(json.dumps(rows[-1]), flush=True)
        command = f"python benchmarks/refine_video.py --cases {given.cases} --cameras {given.cameras}"
        stored = json.loads(RESULT.read_text()) if RESULT.exists() else {}
        stored = {key: value for key, value in stored.items() if key.startswith("cameras_")}
        stored[f"cameras_{given.cameras}"] = {"command": command, "summary": summary(rows), "rows": rows}
        RESULT.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(summary(rows), indent=1))


if __name__ == "__main__":
    main()
