"""How well `physconvex masks` finds the moving object in the videos of captures that come with masks.

Beside it the same finder without the cut along edges, and all that changes: pixels that differ from their median.

    python benchmarks/masks.py BIRD benchmark/captures/*
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import cv2
import numpy as np
import torch

from models import locate_foreground, sharp_foreground
from physconvex.io import load_capture

RESULT = Path(__file__).parent / "results" / "masks.json"
CHANGED = 14  # of 255


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", type=Path, nargs="+", help="folders whose videos have masks")
    parser.add_argument("--out", type=Path, default=RESULT)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    rows = [row for folder in arguments.captures for row in measured(folder)]
    names = ("changed", "finder", "cut")
    means = {name: float(np.mean([row[name]["overlap"] for row in rows])) for name in names}
    arguments.out.write_text(json.dumps({"mean_overlap": means, "videos": rows}, indent=1) + "\n", encoding="utf-8")
    print(means)


def measured(folder: Path) -> list[dict]:
    """One row for each video of a capture."""
    capture, rows = load_capture(folder), []
    for camera in capture.filmed:
        frames, truth = capture.video(camera.name).frames, capture.mask(camera.name)
        median = np.median(frames, axis=0)
        begin = time.process_time()
        cut = sharp_foreground(frames)
        seconds = time.process_time() - begin
        found = {
            "changed": np.abs(frames - median).max(axis=-1) > CHANGED,
            "finder": locate_foreground(frames).mask,
            "cut": cut.mask,
        }
        row = {"capture": folder.name, "camera": camera.name, "frames": len(frames), "confidence": cut.confidence}
        rows.append(row | {name: scores(masks, truth) for name, masks in found.items()} | {"seconds": seconds})
        print(json.dumps(rows[-1]), flush=True)
    return rows


def scores(masks: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Intersection over union, mean and least of all frames; area over the true one."""
    union = (masks | truth).sum(axis=(1, 2))
    shared = (masks & truth).sum(axis=(1, 2)) / np.maximum(union, 1)
    return {"overlap": float(shared.mean()), "least": float(shared.min()), "area": float(masks.sum() / truth.sum())}


if __name__ == "__main__":
    main()
