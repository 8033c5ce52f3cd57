"""What `physconvex diagnose` says of filmed drops, effects hidden or not, from the video of one camera alone.

python benchmarks/gap_video.py --objects FOLDER --out gap_video [--cases damping,none,focal_length]

FOLDER holds Google Scanned Objects, one folder each with `model.obj` and `texture.png`. The toy is dropped by the
full-order model on another mesh than the diagnosis makes, at 24 frames per second and 224 pixels; `capture.json` states
the floor and that the body starts at rest, and nothing of damping. In `focal_length` nothing is amiss but the camera,
whose focal length is stated 3 % too long: that must not be called a material. What is stored of other cases is kept.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from foreign_captures import RESULTS, answer, store

from data_gen.benchmark import BenchmarkOptions, drop_object
from physconvex.capture.folder import CAPTURE_FILE

TOY = "SCHOOL_BUS"
RESULT = RESULTS / "gap_video.json"


@dataclass(frozen=True)
class Film:
    """Damping time of the toy [s], and the stated focal length over the true one."""

    damping_time: float = 0.0
    focal_length: float = 1.0


CASES = {"damping": Film(damping_time=12e-3), "none": Film(), "focal_length": Film(focal_length=1.03)}


def main() -> None:
    """Film, diagnose with the default settings, store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", default=",".join(CASES))
    given = parser.parse_args()
    for name in given.cases.split(","):
        out, film = given.out / name, CASES[name]
        out.mkdir(parents=True, exist_ok=True)
        truth = {"youngs_modulus": 1e5, "poisson_ratio": 0.4, "damping_time": film.damping_time}
        capture = filmed(out / "capture", given.objects, truth, film.focal_length)
        content = {"truth": truth, "focal_length": film.focal_length} | answer(capture, out / "diagnosis")
        store(RESULT, name, content)
        print(json.dumps(content, indent=1))


def filmed(folder: Path, objects: Path, truth: dict[str, float], focal_length: float) -> Path:
    """The capture, whose cameras state so many times their focal length."""
    if not folder.exists():
        options = BenchmarkOptions(size=224, views=2, nodes=600, steps_per_frame=24)
        drop_object(folder, objects / TOY / "model.obj", truth, options, np.random.default_rng(2))
        content = json.loads((folder / CAPTURE_FILE).read_text(encoding="utf-8"))
        for camera in content["cameras"]:
            camera["fl_x"], camera["fl_y"] = focal_length * camera["fl_x"], focal_length * camera["fl_y"]
        (folder / CAPTURE_FILE).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return folder


if __name__ == "__main__":
    main()
