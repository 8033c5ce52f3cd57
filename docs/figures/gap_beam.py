"""Draw `docs/images/gap_beam_*.png`: what the gap reports of the measured silicone beam say.

Run: python -m docs.figures.gap_beam      (reads benchmarks/results/gap_silicone_beam_*.json)
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

ROOT = Path(__file__).parents[2]
RESULTS, IMAGES = ROOT / "benchmarks" / "results", ROOT / "docs" / "images"
RECORDINGS = {"gravity": "own weight", "load101": "102 g hung on"}
COLOURS = {"recording": "black", "base": "#d9772b", "improved": "#2b6ca3"}
MOST = 12  # effects in the chart of scores


def result(name: str) -> dict[str, Any]:
    """A stored report."""
    content: dict[str, Any] = json.loads((RESULTS / f"gap_silicone_beam_{name}.json").read_text(encoding="utf-8"))
    return content


def best_label(report: dict[str, Any]) -> str:
    """Names of the effects of the best fit."""
    return next(" + ".join(h["effects"]) for h in report["which"]["hypotheses"] if h["effects"])


def tip(axes: Axes, report: dict[str, Any]) -> None:
    """Height of the tip: recorded, of the base model, and with the effects of the best fit."""
    times = 1e3 * np.array([frame["time"] for frame in report["where"]["frames"]])
    labels = {"recording": "recording", "base": "elastic model", "improved": f"+ {best_label(report)}"}
    for key, label in labels.items():
        style = "o" if key == "recording" else "-"
        axes.plot(times, report["tip"][key], style, ms=3, lw=1.5, color=COLOURS[key], label=label)
    held_out = times[report["provenance"]["fitted"][-1]] + 5
    axes.axvline(held_out, color="grey", lw=0.8, ls=":")
    axes.text(held_out, 0.97, " not fitted", transform=axes.get_xaxis_transform(), va="top", fontsize=7)
    axes.set_ylabel("tip [mm]")
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.15 * (high - low), high)
    axes.legend(fontsize=7, loc="lower center", ncol=3)


def gap(axes: Axes, report: dict[str, Any]) -> None:
    """Distance between model and recording by frame."""
    frames = report["where"]["frames"]
    times = 1e3 * np.array([frame["time"] for frame in frames])
    for key, colour, label in (
        ("before", COLOURS["base"], "elastic model"), ("after", COLOURS["improved"], "best fit"),
        ("floor", "grey", "noise and numerical error"),
    ):  # fmt: skip
        values = [np.nan if frame[key] is None else 1e3 * frame[key] for frame in frames]
        axes.plot(times, values, "--" if key == "floor" else "-", color=colour, label=label)
    axes.set_ylabel("gap, rms [mm]")
    axes.set_xlabel("time since the release [ms]")
    axes.set_ylim(0, 1.2 * axes.get_ylim()[1])
    axes.legend(fontsize=7, loc="upper center", ncol=3)


def scores(axes: Axes, report: dict[str, Any]) -> None:
    """Share of the residual that one dose of each effect explains at the base fit."""
    best: dict[str, float] = {}
    for entry in report["which"]["screening"]:
        best[entry["effect"]] = max(entry["explained"], best.get(entry["effect"], 0.0))
    names = sorted(best, key=lambda name: -best[name])[:MOST]
    chosen = set(best_label(report).split(" + "))
    axes.barh(names, [100 * best[n] for n in names], color=["#2b6ca3" if n in chosen else "#b8b8b8" for n in names])
    axes.invert_yaxis()
    axes.tick_params(labelsize=7)
    axes.set_xlabel("residual explained at the base fit [%]")


def fits(axes: Axes, report: dict[str, Any]) -> None:
    """Evidence of the full-order fits over that of the base model."""
    found = report["which"]["hypotheses"]
    base = next(h["evidence"] for h in found if not h["effects"])
    names = [" + ".join(h["effects"]) or "elastic model" for h in found]
    axes.barh(range(len(found)), [h["evidence"] - base for h in found], color="#2b6ca3")
    axes.set_yticks(range(len(found)), names, fontsize=7)
    axes.invert_yaxis()
    axes.set_xlabel("log-evidence over that of the elastic model")


def main() -> None:
    """Draw all pictures."""
    IMAGES.mkdir(exist_ok=True)
    reports = {name: result(name) for name in RECORDINGS}
    figure, panels = plt.subplots(2, 2, figsize=(10, 5.4), layout="constrained", sharex=True)
    for column, (name, title) in enumerate(RECORDINGS.items()):
        tip(panels[0, column], reports[name])
        gap(panels[1, column], reports[name])
        panels[0, column].set_title(title, fontsize=10)
    figure.savefig(IMAGES / "gap_beam_motion.png", dpi=110)
    figure, panels = plt.subplots(2, 2, figsize=(10, 5.6), layout="constrained")
    for column, (name, title) in enumerate(RECORDINGS.items()):
        scores(panels[0, column], reports[name])
        fits(panels[1, column], reports[name])
        panels[0, column].set_title(title, fontsize=10)
    figure.savefig(IMAGES / "gap_beam_which.png", dpi=110)


if __name__ == "__main__":
    main()
