"""What `physconvex diagnose` says of a real tennis ball that another one has struck (Du et al. 2021, DiffPD).

python benchmarks/gap_tennis_balls.py --data DATA --out diagnosis_of_ball     (DATA: ball_positions.csv of that work)

The first ball from the frame after the collision on: its centre on the floor plane, 60 frames per second, triangulated
from a video by the authors. The base model is an elastic ball that slides on a floor without friction; the real one
slides, begins to roll, and slows down while it rolls.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
import torch
import trimesh

from physconvex.capture import Capture, Floor, Tracks, save_capture
from physconvex.gap import diagnose

RESULT = Path(__file__).parent / "results" / "gap_tennis_ball.json"
RADIUS, MASS = 0.03429, 0.0577  # m, kg: a tennis ball
FIRST, FRAMES, OBSERVED = 12, 36, 24  # the collision lies between rows 10 and 11
SIGMA = 5e-4  # m: what the triangulated path of the resting ball scatters by


def ball_capture(folder: Path, data: Path) -> Capture:
    """The struck ball as a capture of one marker, its centre."""
    table = np.genfromtxt(data, delimiter=",", names=True)
    path = np.stack([table[f"b1_{axis}_m"] for axis in "xyz"], axis=1)[FIRST : FIRST + FRAMES]
    ball = trimesh.creation.icosphere(subdivisions=2, radius=RADIUS)
    ball.apply_translation(path[0])
    up = np.array([0.0, 0.0, 1.0])
    capture = Capture(
        folder, 60.0, FRAMES, OBSERVED, gravity=-9.81 * up, floor=Floor(np.zeros(3), up),
        density=MASS / float(ball.volume),
    )  # fmt: skip
    save_capture(capture, mesh=ball, tracks=Tracks(path[:1].copy(), path[:, None], np.full((FRAMES, 1), SIGMA)))
    return capture


def main() -> None:
    """Diagnose and store the report's JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="ball_positions.csv")
    parser.add_argument("--out", type=Path, required=True, help="folder of the report")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        report = diagnose(ball_capture(Path(folder) / "ball", arguments.data), on_progress=print)
    report.save(arguments.out)
    print(report.verdict.sentence, report.how_far[0], sep="\n")
    content = report.to_json()
    for key in ("points", "frames"):
        content["where"].pop(key)
    RESULT.write_text(json.dumps(content, indent=1, default=lambda v: v.tolist()) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
