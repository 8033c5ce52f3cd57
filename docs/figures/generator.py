"""Draw `docs/images/generator.png`: eight clips of a data set, eight frames each.

Run: physconvex generate dataset --out DATA --count 8 && python docs/figures/generator.py DATA
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from data_gen import ClipRecord, Dataset

CLIPS, FRAMES = 8, 8
TARGET = Path(__file__).parents[1] / "images" / "generator.png"


def strip(clip: ClipRecord) -> np.ndarray:
    """Frames evenly spread over a clip, side by side."""
    frames = clip.frames()
    chosen = np.linspace(0, len(frames) - 1, FRAMES).round().astype(int)
    return np.hstack(list(frames[chosen]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of a data set with at least eight simulations")
    parser.add_argument("--out", type=Path, default=TARGET)
    arguments = parser.parse_args()
    clips = Dataset.open(arguments.data).clips
    first_views = [clip for clip in clips if clip.view == 0][:CLIPS]
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.vstack([strip(clip) for clip in first_views])).quantize(256).save(arguments.out, optimize=True)


if __name__ == "__main__":
    main()
