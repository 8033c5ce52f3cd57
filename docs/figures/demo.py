"""Draw `docs/images/demo.png`: what `physconvex predict` found in the bundled clips.

Run: ./run-demo && python docs/figures/demo.py demo_output
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from inference import format_pascals, format_pascals_range

TARGET = Path(__file__).parents[1] / "images" / "demo.png"


def main() -> None:
    """One row per clip: frames with the found outline, skinning weights, estimates with their intervals."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path, help="folder that `physconvex predict` wrote")
    parser.add_argument("--out", type=Path, default=TARGET)
    arguments = parser.parse_args()
    records = [json.loads(p.read_text()) for p in sorted((arguments.results / "clips").glob("*.json"))]
    figure, axes = plt.subplots(len(records), 2, figsize=(11, 0.95 * len(records)), width_ratios=(2.6, 1))
    for (frames, field), record in zip(axes, records, strict=True):
        folder = arguments.results / "clips"
        frames.imshow(plt.imread(folder / f"{record['name']}.jpg"))
        field.imshow(plt.imread(folder / f"{record['name']}.skinning.png"))
        low, high = record["youngs_modulus_interval"]
        title = (
            f"{record['name']}: E = {format_pascals(record['youngs_modulus'])} ({format_pascals_range(low, high)}), "
            f"ν = {record['poisson_ratio']:.2f} ({'–'.join(f'{v:.2f}' for v in record['poisson_ratio_interval'])})"
        )
        frames.set_title(title, fontsize=7, loc="left", pad=2)
        for axis in (frames, field):
            axis.set_axis_off()
    figure.tight_layout(pad=0.3)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(arguments.out, dpi=130)


if __name__ == "__main__":
    main()
