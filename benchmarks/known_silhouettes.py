"""How well stiffness could be read if the object were found perfectly: by resolution, and by number of simulations.

What the network reads of silhouettes (`models.kinematics`, `models.motion`; no pixels) is trained on the true masks of
a data set, at several resolutions of the picture and on several numbers of simulations, and measured on every fifth
object. Also the states of the motion, in their typical magnitudes.

    python benchmarks/known_silhouettes.py --data data/large
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import cv2
import numpy as np
import torch
from known_states import labels_of
from torch import Tensor, nn

from models import (
    STATE_SCALE,
    KinematicsConfig,
    MotionBranch,
    SilhouetteFeatures,
    mirrored_moments,
    silhouette_moments,
    touches_border,
)
from train import flipped_states, read_clips

RESULT = Path(__file__).parent / "results" / "known_silhouettes.json"
BATCH, HELD_OUT = 48, 5


class Reader(nn.Module):
    """Moments -> states, and log10 E/(ρ g L) less its mean."""

    def __init__(self) -> None:
        super().__init__()
        config = KinematicsConfig()
        self.features, self.motion = SilhouetteFeatures(config.channels), MotionBranch(config)
        self.out = nn.Linear(self.motion.out_features, 1)

    def forward(self, moments: Tensor, interval: Tensor) -> tuple[Tensor, Tensor]:
        valid = torch.ones(moments.shape[:2], dtype=torch.bool)
        motion = self.motion(self.features(moments, interval, valid), interval, valid)
        return motion.states, self.out(motion.embedding)[:, 0]


class Clips:
    """Of a data set: moments by resolution, states, and labels; numbers of object and simulation."""

    def __init__(self, data: Path, edges: list[int]) -> None:
        clips = read_clips([data])
        self.states, self.interval, self.stiffness, _ = labels_of(clips)
        self.objects = np.unique([clip.record.row["object_id"] for clip in clips], return_inverse=True)[1]
        self.simulations = np.array([clip.record.row["simulation"] for clip in clips])
        masks = [clip.record.mask() for clip in clips]
        self.moments = {edge: np.stack([_moments(mask, edge) for mask in masks]) for edge in edges}


def _moments(mask: np.ndarray, edge: int) -> np.ndarray:
    """Of the true mask as a picture of that edge would show it."""
    whole = mask.astype(np.uint8) * np.uint8(255)
    small = np.stack([cv2.resize(frame, (edge, edge), interpolation=cv2.INTER_AREA) for frame in whole])
    return silhouette_moments((small > 127) * np.uint8(255), touches_border=touches_border(mask)).moments


def measure(clips: Clips, edge: int, simulations: int | None, steps: int) -> dict[str, float]:
    """Errors on held-out objects after training on so many simulations of the others."""
    held = clips.objects % HELD_OUT == 0
    numbers = np.unique(clips.simulations[~held])[:simulations]
    chosen = np.flatnonzero(~held & np.isin(clips.simulations, numbers))
    moments, states, interval = clips.moments[edge], clips.states, torch.tensor(clips.interval, dtype=torch.float32)
    mirrored = np.stack([mirrored_moments(clip) for clip in moments]), np.stack([flipped_states(s) for s in states])
    mean = float(clips.stiffness[chosen].mean())
    wanted = torch.tensor(clips.stiffness - mean, dtype=torch.float32)
    torch.manual_seed(0)
    rng, reader = np.random.default_rng(0), Reader()
    optimizer = torch.optim.AdamW(reader.parameters(), lr=1e-3, weight_decay=0.05)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 1.5e-3, total_steps=steps)
    for _ in range(steps):
        index, flip = rng.choice(chosen, BATCH), (rng.random(BATCH) < 0.5)[:, None, None]
        shown = torch.from_numpy(np.where(flip, mirrored[0][index], moments[index]))
        truth = torch.from_numpy(np.where(flip, mirrored[1][index], states[index]))
        found, stiffness = reader(shown, interval[index])
        loss = 2 * ((found - truth) / STATE_SCALE).abs().mean() + 0.3 * (stiffness - wanted[index]).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(reader.parameters(), 1.0)
        optimizer.step()
        schedule.step()
    reader.eval()
    with torch.no_grad():
        found, stiffness = reader(torch.from_numpy(moments[held]), interval[torch.from_numpy(held)])
    truth = torch.from_numpy(states[held])
    constant = np.abs(clips.stiffness[held] - np.median(clips.stiffness[chosen])).mean()
    return {
        "edge": edge,
        "simulations": len(numbers),
        "states": float(((found - truth) / STATE_SCALE).abs().mean()),
        "mae_log10_stiffness": float((stiffness - wanted[torch.from_numpy(held)]).abs().mean()),
        "constant": float(constant),
    }


def main() -> None:
    """Train, measure, print and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="pictures as large as the largest of --edges")
    parser.add_argument("--edges", type=int, nargs="+", default=[64, 128, 256])
    parser.add_argument("--simulations", type=int, nargs="*", default=[30, 60, 120])
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=RESULT)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    clips = Clips(options.data, options.edges)
    middle = sorted(options.edges)[len(options.edges) // 2]
    rows = []
    print(f"{'edge':>6}{'simulations':>13}{'states off by':>15}{'MAE log10 E':>13}{'constant':>10}")
    for edge, count in [*((middle, n) for n in options.simulations), *((edge, None) for edge in options.edges)]:
        row = measure(clips, edge, count, options.steps)
        rows.append(row)
        print(
            f"{edge:6d}{row['simulations']:13.0f}{row['states']:15.3f}{row['mae_log10_stiffness']:13.3f}"
            f"{row['constant']:10.3f}",
            flush=True,
        )
    held = int((clips.objects % HELD_OUT == 0).sum())
    tree = {
        "command": "python " + " ".join([f"benchmarks/{Path(__file__).name}", *sys.argv[1:]]),
        "held_out_clips": held,
        "rows": rows,
    }
    options.out.write_text(json.dumps(tree, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
