"""Draw `docs/images/training.png`: how a run of `physconvex pretrain` went, from its log.

Run: python docs/figures/training_curves.py docs/results/falls_log.jsonl
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib.pyplot as plt

TARGET = Path(__file__).parents[1] / "images" / "training.png"
NAMES = {"falls": "held-out falls", "real": "validation clips"}
PANELS = {
    "log10_stiffness_mae": "mean absolute error of log10 E",
    "poisson_mae": "mean absolute error of ν",
    "states": "error of the states",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("log", type=Path, help="log.jsonl of the run")
    parser.add_argument("--out", type=Path, default=TARGET)
    arguments = parser.parse_args()
    lines = [json.loads(line) for line in arguments.log.read_text(encoding="utf-8").splitlines()]
    trained, looked = ([line for line in lines if line["kind"] == kind] for kind in ("train", "validation"))
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.2), layout="constrained")
    axes[0].plot([line["step"] for line in trained], [line["material"] for line in trained], label="material")
    axes[0].plot([line["step"] for line in trained], [line["states"] for line in trained], label="states")
    axes[0].set_title("loss", fontsize=10)
    for axis, (key, title) in zip(axes[1:], PANELS.items(), strict=True):
        for name, label in NAMES.items():
            seen = [line for line in looked if name in line]
            axis.plot([line["step"] for line in seen], [line[name][key] for line in seen], label=label)
        axis.set_title(title, fontsize=10)
    for axis in axes:
        axis.set_xlabel("step")
        axis.set_ylim(bottom=0)
        axis.legend(fontsize=8)
        axis.grid(alpha=0.3)
    figure.savefig(arguments.out, dpi=100)


if __name__ == "__main__":
    main()
