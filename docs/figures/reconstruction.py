"""Picture of docs/results/convex_field.md: a held-out view of each object: observed, rendered, difference.

The folders are what `benchmarks/reconstruction.py --work WORK` left: WORK/<object>-448-result.

python docs/figures/reconstruction.py WORK [--view held0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

OUT = Path(__file__).parents[1] / "images" / "reconstruction.png"
SUFFIX = "-448-result"


def main() -> None:
    """Draw one row per object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--view", default="held0")
    options = parser.parse_args()
    found = sorted(options.work.glob(f"*{SUFFIX}/views/{options.view}.png"))
    figure, axes = plt.subplots(len(found), 1, figsize=(9, 3.2 * len(found)), layout="constrained", squeeze=False)
    for axis, path in zip(axes[:, 0], found, strict=True):
        name = path.parents[1].name.removesuffix(SUFFIX).replace("_", " ")
        axis.imshow(np.asarray(Image.open(path)))
        axis.set_title(f"{name}: held-out view, rendered, four times the difference", fontsize=9)
        axis.axis("off")
    figure.savefig(OUT, dpi=110)


if __name__ == "__main__":
    main()
