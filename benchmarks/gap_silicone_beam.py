"""Run `physconvex diagnose` on the measured silicone beam (Dubied et al. 2022).

python benchmarks/gap_silicone_beam.py --out diagnosis_of_beam

The beam is released under its own weight, or with 102 g on its end. The elastic twin does not know the load. The
benchmark locates the gap, finds the effect that explains it, and measures the shrinkage.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch

from physconvex.gap import GapReport, diagnose
from physconvex.identify import MarkerObservations
from physconvex.io import load_capture

RESULTS = Path(__file__).parent / "results"
CAPTURES = Path(__file__).parents[1] / "examples" / "captures"


def tip_heights(report: GapReport) -> dict[str, list[float]]:
    """Mean height of the three tip markers above the held place [mm], by frame: observed, base model, improved."""
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
        report = diagnose(load_capture(CAPTURES / f"silicone_beam_{name}"), on_progress=print)
        report.save(arguments.out / name)
        print(name, report.verdict.sentence, report.how_far[0], sep="\n")
        content = report.to_json()
        content["where"].pop("points")
        content["tip"] = tip_heights(report)
        text = json.dumps(content, indent=1, default=lambda v: v.tolist())
        (RESULTS / f"gap_silicone_beam_{name}.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
