"""Refinement with its defaults from one front video of a scanned object that is dropped: errors, intervals, time.

python benchmarks/refine_objects.py --objects gso/ --cases bus kong lion --work out/      (goes on where it stopped)

The capture holds the front video before white, its masks, and the object's mesh; 16 of 24 frames are fitted. Truth:
quadratic elements of at most 1,000 nodes, 24 steps per frame, the floor acting on the surface that is shown.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch

from data_gen import BenchmarkOptions, drop_object, objects_from_folder
from inference import RefineOptions, refine

RESULT = Path(__file__).parent / "results" / "refine_objects.json"
DAMPING = 1e-3
# name, log10 E, ν, pixels, seed
CASES = {
    "lion": ("Schleich_Lion_Action_Figure", 4.7, 0.30, 224, 1),
    "bus": ("SCHOOL_BUS", 5.3, 0.40, 224, 2),
    "mug": ("Room_Essentials_Mug_White_Yellow", 5.0, 0.25, 448, 3),
    "kong": ("Kong_Puppy_Teething_Rubber_Small_Pink", 5.9, 0.45, 224, 4),
}


def measure(case: str, objects: Path, work: Path) -> dict[str, object]:
    """Make the capture unless it is there, refine it, compare."""
    name, modulus, ratio, size, seed = CASES[case]
    truth = {"youngs_modulus": 10**modulus, "poisson_ratio": ratio, "damping_time": DAMPING}
    paths = {path.parent.name: path for path in objects_from_folder(objects)}
    options = BenchmarkOptions(size=size, views=2, nodes=1000, steps_per_frame=24)
    folder, moved = drop_object(work / case, paths[name], truth, options, np.random.default_rng(seed))
    clock = time.process_time()
    found = refine(folder, out=work / f"{case}_refined", options=RefineOptions(start="scan"))
    seconds = time.process_time() - clock
    true = {"log10_youngs_modulus": modulus, "poisson_ratio": ratio, "damping_time": DAMPING}
    distance = 1e3 * np.sqrt(np.square(found.motion.vertices - moved).sum(-1).mean(-1))
    return {
        "case": case,
        "truth": true,
        "error": {e.name: e.value - true[e.name] for e in found.estimates},
        "interval_90": {e.name: e.interval for e in found.estimates},
        "reduced_alone": found.reduced_values.tolist(),
        "residual_rms": found.residual_rms,
        "model_error_by_frame": found.frame_errors.tolist(),
        "surface_rms_mm": distance.round(2).tolist(),
        "in_words": [*found.identifiability.sentences, *found.warnings],
        "process_seconds": round(seconds, 1),
    }


def main() -> None:
    """Run the cases that are not there yet, and store the table after each."""
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--objects", type=Path, required=True)
    parser.add_argument("--cases", nargs="+", choices=sorted(CASES), default=sorted(CASES))
    parser.add_argument("--work", type=Path, required=True)
    given = parser.parse_args()
    rows = {row["case"]: row for row in (json.loads(RESULT.read_text())["rows"] if RESULT.exists() else [])}
    for case in given.cases:
        rows[case] = measure(case, given.objects, given.work)
        print(json.dumps(rows[case]), flush=True)
        content = {
            "command": "python benchmarks/refine_objects.py --objects gso/ --work out/",
            "rows": [*rows.values()],
        }
        RESULT.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
