"""Draw `docs/images/reduced_accuracy.png` and print the tables of docs/results/reduced_model.md.

Run: python -m docs.figures.reduced_accuracy      (reads benchmarks/results/reduced_accuracy.json)
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

ROOT = Path(__file__).parents[2]
RESULT = ROOT / "benchmarks" / "results" / "reduced_accuracy.json"
TARGET = ROOT / "docs" / "images" / "reduced_accuracy.png"
BASES = {
    "elastic": "#2b6ca3",
    "eigenmodes": "#d9772b",
    "snapshots": "#8b5fbf",
    "neural": "#b0413e",
    "predicted": "#777777",
    "paper": "black",
}
BODIES = ("cube", "bar", "spot", "koala", "Kong", "Android")
SETTLED = 1e-3
FEWEST = 6  # rows that a median needs
QUANTITIES = {
    "distance": ("rms distance at the true E and ν / motion", None),
    "modulus": ("|bias of log10 E|", 0.02),
    "ratio": ("|bias of ν|", 0.03),
}


@dataclass(frozen=True)
class Row:
    """One stored row: lengths in metres, what was fitted minus the truth."""

    scene: str
    body: str
    youngs_modulus: float
    poisson_ratio: float
    basis: str
    weights: int
    motion: float
    at_truth: float
    fitted: float
    bias_modulus: float
    bias_ratio: float
    settled: bool
    failed: bool

    @property
    def distance(self) -> float:
        """Over the motion, at the true E and ν [-]."""
        return self.at_truth / self.motion

    @property
    def modulus(self) -> float:
        """|bias of log10 E|."""
        return abs(self.bias_modulus)

    @property
    def ratio(self) -> float:
        """|bias of ν|."""
        return abs(self.bias_ratio)


def rows() -> list[Row]:
    """All stored rows, in the order of the tables."""
    found = []
    for row in json.loads(RESULT.read_text(encoding="utf-8"))["rows"]:
        case = row["case"]
        found.append(
            Row(
                case["scene"], next(b for b in BODIES if b in case["body"]), case["youngs_modulus"],
                case["poisson_ratio"], case["basis"], case["weights"], row["motion"], row["rms_at_truth"],
                row["rms_fitted"], row["bias_log10_youngs_modulus"], row["bias_poisson_ratio"],
                row["last_step"] < SETTLED, bool(row["failure"]),
            )
        )  # fmt: skip
    return sorted(found, key=lambda r: (r.scene, r.youngs_modulus, r.poisson_ratio, BODIES.index(r.body)))


def kinds(of: list[Row]) -> dict[tuple[str, int], list[Row]]:
    """Rows that came to a fit, by basis and number of weights."""
    return {
        (basis, count): [r for r in of if (r.basis, r.weights) == (basis, count) and not r.failed]
        for basis in BASES
        for count in sorted({r.weights for r in of if r.basis == basis})
    }


def signed(value: float, settled: bool) -> str:
    """With a star where the fit had not settled."""
    return f"{value:+.3f}".replace("-", "−") + ("" if settled else "*")


def summary(of: list[Row]) -> None:
    """One line for each basis and number of weights: median and largest of each quantity."""
    print(
        "| basis | M | rows | distance / motion | bias of log10 E | bias of ν | within both bars |\n" + "|---" * 7 + "|"
    )
    for (basis, count), some in kinds(of).items():
        if len(some) < FEWEST:
            continue
        cells = [
            f"{np.median([getattr(r, q) for r in some]):.3f} ({max(getattr(r, q) for r in some):.3f})"
            for q in QUANTITIES
        ]
        inside = sum(r.modulus <= 0.02 and r.ratio <= 0.03 for r in some)
        failed = sum(r.failed and (r.basis, r.weights) == (basis, count) for r in of)
        told = f"{len(some)}" + (f" ({failed} failed)" if failed else "")
        print(f"| {basis} | {count} | {told} | {' | '.join(cells)} | {inside} |")


def listing(of: list[Row]) -> None:
    """Every row of one kind."""
    print("| scene | E [Pa] | ν | body | motion [mm] | rms at truth [mm] | fitted [mm] | bias of log10 E | bias of ν |")
    print("|---" * 9 + "|")
    for r in of:
        print(
            f"| {r.scene} | {r.youngs_modulus:.0e} | {r.poisson_ratio} | {r.body} | {1e3 * r.motion:.0f} | "
            f"{1e3 * r.at_truth:.2f} | {1e3 * r.fitted:.2f} | {signed(r.bias_modulus, r.settled)} | "
            f"{signed(r.bias_ratio, r.settled)} |"
        )


def draw(of: list[Row]) -> None:
    """Each quantity against the number of weights: a point for each row, lines through the medians."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
    for axis, (quantity, (title, bar)) in zip(axes, QUANTITIES.items(), strict=True):
        lowest = 1e-4 if bar is None else SETTLED  # what a settled fit leaves open
        for number, (basis, colour) in enumerate(BASES.items()):
            found = {count: some for (name, count), some in kinds(of).items() if name == basis}
            medians = {
                count: max(lowest, np.median([getattr(r, quantity) for r in some]))
                for count, some in found.items()
                if len(some) >= FEWEST
            }
            axis.plot(list(medians), list(medians.values()), color=colour, marker="o", label=basis, zorder=3)
            for count, some in found.items():
                values = np.maximum([getattr(r, quantity) for r in some], lowest)
                axis.scatter(
                    np.full(len(some), count * (1 + 0.015 * (number - 2))), values, 5, color=colour, alpha=0.35
                )
        if bar is not None:
            axis.axhline(bar, color="grey", linestyle="--", linewidth=1)
        axis.set(title=title, xlabel="weights M", xscale="log", yscale="log")
        axis.set_xticks([4, 8, 12, 20, 30, 40, 60], labels=["4", "8", "12", "20", "30", "40", "60"])
        axis.minorticks_off()
    axes[0].legend(fontsize=8)
    figure.savefig(TARGET, dpi=110)


def main() -> None:
    """Draw and print."""
    found = rows()
    drops = [r for r in found if r.scene == "drop"]
    draw(drops)
    summary(drops)
    print()
    summary([r for r in found if r.scene == "release"])
    print()
    listing([r for r in found if (r.basis, r.weights) == ("elastic", 60)])


if __name__ == "__main__":
    main()
