"""How well and how fast `locate_foreground` finds the object in the test clips of a data set.

python benchmarks/foreground.py --data data/main --out docs/results/data/foreground.json
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

import physconvex
from models import locate_foreground
from train import LabelledClip, dataset_checksum, overlap_of_frames, read_clips

RESULT = Path(__file__).parent.parent / "docs" / "results" / "data" / "foreground.json"
POOR = 0.7


@dataclass(frozen=True, kw_only=True)
class ForegroundResult:
    """Overlap is the intersection over union with the true mask, mean over the frames of a clip."""

    command: str
    version: str
    machine: str
    data: dict[str, str]
    """Name and manifest SHA-256."""
    split: str
    clips: int
    frames: int
    side: int
    """Of the clips [px]."""
    overlap_mean: float
    overlap_median: float
    share_below_0_7: float
    size_spread_median: float
    """Standard deviation within a clip of the root of the area found, over that of the true one."""
    not_found: int
    """Clips shown as a whole frame."""
    milliseconds_per_clip: float
    """Processor time on one thread, median over clips of the fastest of the repeats."""


def main() -> None:
    arguments = _arguments()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    clips = read_clips([arguments.data], "test")
    result = _measure(clips, arguments.data, arguments.repeats)
    text = json.dumps(asdict(result), indent=1)
    print(text)
    arguments.out.write_text(text + "\n", encoding="utf-8")


def _measure(clips: list[LabelledClip], data: Path, repeats: int) -> ForegroundResult:
    overlaps, spreads, times, missing = [], [], [], 0
    for clip in clips:
        frames, truth = clip.record.frames(), clip.record.mask()
        found = locate_foreground(frames)
        missing += found.source == "whole_frame"
        overlaps.append(overlap_of_frames(found.mask, truth))
        spreads.append(_size_spread(found.mask, truth))
        times.append(min(_seconds(frames) for _ in range(repeats)))
    return ForegroundResult(
        command=f"python benchmarks/foreground.py --data data/{data.name}",
        version=physconvex.__version__,
        machine=f"{platform.machine()}, one thread",
        data={data.name: dataset_checksum(data)},
        split="test",
        clips=len(clips),
        frames=len(frames),
        side=max(frames.shape[1:3]),
        overlap_mean=float(np.mean(overlaps)),
        overlap_median=float(np.median(overlaps)),
        share_below_0_7=float(np.mean(np.array(overlaps) < POOR)),
        size_spread_median=float(np.median(spreads)),
        not_found=int(missing),
        milliseconds_per_clip=1e3 * float(np.median(times)),
    )


def _size_spread(found: np.ndarray, true: np.ndarray) -> float:
    areas = [mask.sum(axis=(1, 2)) for mask in (found, true)]
    seen = areas[1] > 0
    return float(np.std(np.sqrt(areas[0][seen] / areas[1][seen])))


def _seconds(frames: np.ndarray) -> float:
    start = time.process_time()
    locate_foreground(frames)
    return time.process_time() - start


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="data set of `physconvex generate`")
    parser.add_argument("--out", type=Path, default=RESULT)
    parser.add_argument("--repeats", type=int, default=3)
    return parser.parse_args()


if __name__ == "__main__":
    main()
