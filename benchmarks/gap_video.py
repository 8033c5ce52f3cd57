"""What `physconvex diagnose` says of a filmed drop with hidden damping, from the video of one camera alone.

python benchmarks/gap_video.py --objects FOLDER --out gap_video

FOLDER holds Google Scanned Objects, one folder each with `model.obj` and `texture.png`. The toy is dropped by the
full-order model on another mesh than the diagnosis makes, at 24 frames per second and 224 pixels; `capture.json` states
the floor and that the body starts at rest, and nothing of damping.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from data_gen.benchmark import BenchmarkOptions, drop_object
from physconvex.gap import diagnose

TOY = "SCHOOL_BUS"
TRUTH = {"youngs_modulus": 1e5, "poisson_ratio": 0.4, "damping_time": 12e-3}
RESULT = Path(__file__).parent / "results" / "gap_video.json"


def main() -> None:
    """Film, diagnose with the default settings, store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    options = BenchmarkOptions(size=224, views=2, nodes=600, steps_per_frame=24)
    folder, _ = drop_object(
        given.out / "capture", given.objects / TOY / "model.obj", TRUTH, options, np.random.default_rng(2)
    )
    report = diagnose(folder)
    report.save(given.out / "diagnosis")
    content = {"command": "python benchmarks/gap_video.py --objects FOLDER --out OUT", "truth": TRUTH}
    content |= summary(json.loads((given.out / "diagnosis" / "report.json").read_text(encoding="utf-8")))
    RESULT.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(content, indent=1))


def summary(content: dict) -> dict:
    """Of a report: verdict, doses, what was fitted, and the gap on held-out frames [m]."""
    which, how_far = content["which"], content["how_far"]
    return {
        "verdict": which["verdict"],
        "sentence": which["sentence"],
        "caveats": which["caveats"],
        "hypotheses": which["hypotheses"],
        "parameters": how_far["parameters"],
        "gap": [how_far["gap_before"], how_far["gap_after"], how_far["noise_floor"]],
        "shrinkage": [how_far["shrinkage"], *how_far["interval"]],
        "placebo": how_far["placebo"],
        "seconds": content["provenance"]["seconds"],
    }


if __name__ == "__main__":
    main()
