"""What `physconvex diagnose` says of the measured silicone beam (Dubied et al. 2022).

python benchmarks/gap_silicone_beam.py --out diagnosis_of_beam

A plain elastic twin of the beam that is let go under its own weight, or with 102 g hung on its end, which the twin
does not know of: where does it part from the recording, which effect explains it, how far does it shrink?
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
import torch
from scipy.interpolate import CubicSpline

from docs.figures.fem_cases.measured import GRAVITY, recording
from physconvex.capture import Boundary, Capture, Tracks, save_capture
from physconvex.fem import TetMesh, box_mesh
from physconvex.gap import GapReport, diagnose
from physconvex.identify import MarkerObservations

RESULTS = Path(__file__).parent / "results"
SIGMA = 1e-4  # m: what markers that shake on 6 mm feet are off by; the camera system's own noise is 5 to 15 µm
FRAMES, OBSERVED, OFFSET_MS = 45, 30, -2.5  # the release lies within a frame


def beam_capture(folder: Path, name: str) -> Capture:
    """The recording from its release on, as a capture: six-marker tracks of the tip, clamped at the base."""
    run = recording(name)
    rest = run.held(run.tips)
    times = run.times[run.release_frame] + 1e-3 * OFFSET_MS + np.arange(FRAMES) / 100
    positions = CubicSpline(run.times, run.tips)(times)
    positions[0] = rest
    capture = Capture(
        folder, 100.0, FRAMES, OBSERVED, gravity=np.array(GRAVITY), density=1070.0, initial_velocity=np.zeros(3),
        initial_angular_velocity=np.zeros(3),
    )  # fmt: skip
    box = box_mesh((0.1, 0.03, 0.03), (8, 1, 1), order=1)
    tets = TetMesh(box.vertices - np.array([0.1, 0, 0]), box.tets)
    clamp = Boundary(clamped_box=np.array([[-0.1001, -1, -1], [-0.0999, 1, 1]]))
    tracks = Tracks(rest, positions, np.full(positions.shape[:2], SIGMA))
    save_capture(capture, tets=tets, tracks=tracks, boundary=clamp)
    return capture


def tip_heights(report: GapReport) -> dict[str, list[float]]:
    """Mean height of the three tip markers over where it was held [mm], by frame: seen, base model, improved."""
    seen = report.base.observations
    assert isinstance(seen, MarkerObservations)
    return {
        name: np.round(1e3 * (positions - seen.points)[..., 2].mean(1), 3).tolist()
        for name, positions in (
            ("recording", seen.positions), ("base", report.base.positions), ("improved", report.best.positions),
        )
    }  # fmt: skip


def main() -> None:
    """Diagnose the recordings and store the reports' JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the reports")
    parser.add_argument("--recordings", nargs="+", default=["gravity", "load101"])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    for name in arguments.recordings:
        with tempfile.TemporaryDirectory() as folder:
            report = diagnose(beam_capture(Path(folder) / name, name), on_progress=print)
        report.save(arguments.out / name)
        print(name, report.verdict.sentence, report.how_far[0], sep="\n")
        content = report.to_json()
        content["where"].pop("points")
        content["tip"] = tip_heights(report)
        text = json.dumps(content, indent=1, default=lambda v: v.tolist())
        (RESULTS / f"gap_silicone_beam_{name}.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
