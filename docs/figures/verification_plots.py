"""The figures of docs/results/physics.md, from the stored numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import NullLocator

__all__ = ["draw_all"]


def _guide(axes: plt.Axes, sizes: list[float], error: float, order: int) -> None:
    """Dashed line of the theoretical order through the finest error."""
    h = np.array([min(sizes), max(sizes)])
    axes.loglog(h, error * (h / h[0]) ** order, "k--", lw=0.8)
    axes.annotate(
        f"order {order}",
        (h[1], error * (h[1] / h[0]) ** order),
        fontsize=8,
        ha="right",
        va="bottom",
        xytext=(-8, 2),
        textcoords="offset points",
    )


def _plain_ticks(axes: plt.Axes, values: list[float]) -> None:
    """Ticks of a logarithmic x axis at these values alone."""
    axes.set_xticks(values, [f"{value:g}" for value in values])
    axes.xaxis.set_minor_locator(NullLocator())


def draw_space(content: dict[str, Any]) -> plt.Figure:
    figure, panels = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    titles = {"displacement": "displacement [m$^{5/2}$]", "gradient": "gradient [m$^{3/2}$]"}
    for axes, (norm, title) in zip(panels, titles.items(), strict=True):
        for run in content["convergence"]["space"]:
            order = int(run["name"][1])
            label = f"{run['name']}: fitted order {run['slopes'][norm]:.2f}"
            axes.loglog(run["sizes"], run["errors"][norm], "o-", label=label)
            _guide(axes, run["sizes"], run["errors"][norm][-1], order + (norm == "displacement"))
        axes.set(xlabel="edge of a cell [m]", ylabel=f"L2 error of the {title}")
        _plain_ticks(axes, [1 / 16, 1 / 8, 1 / 4, 1 / 2])
        axes.legend(loc="lower right")
    return figure


def draw_time(content: dict[str, Any]) -> plt.Figure:
    figure, axes = plt.subplots(figsize=(5.5, 3.8), layout="constrained")
    for run, order in zip(content["convergence"]["time"], (1, 2), strict=True):
        label = f"{run['name']}: fitted order {run['slopes']['position']:.2f}"
        axes.loglog(run["sizes"], run["errors"]["position"], "o-", label=label)
        _guide(axes, run["sizes"], run["errors"]["position"][-1], order)
    axes.set(xlabel="time step [s]", ylabel="largest error of a position after 0.5 s [m]")
    axes.legend(loc="lower right")
    return figure


def draw_beams(content: dict[str, Any]) -> plt.Figure:
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    for key, label in (("cantilever", "P2"), ("cantilever_linear", "P1")):
        rows = content["beams"][key]
        ratio = [row["tip"] / row["euler_bernoulli"] for row in rows]
        left.semilogx([row["slenderness"] for row in rows], ratio, "o", label=f"{label}, two cells through the height")
    rows = content["beams"]["cantilever"]
    bending, both = rows[0]["euler_bernoulli"], rows[0]["timoshenko"]
    shear = (both / bending - 1) * rows[0]["slenderness"] ** 2  # shear over bending falls with (h/L)²
    lengths = np.geomspace(2, 32, 100)
    left.semilogx(lengths, 1 + shear / lengths**2, "k-", lw=1, label="Timoshenko")
    left.axhline(1.0, color="grey", lw=0.8, ls="--", label="Euler–Bernoulli")
    _plain_ticks(left, [row["slenderness"] for row in rows])
    left.set(xlabel="length / height", ylabel="tip deflection / Euler–Bernoulli")
    left.legend(fontsize=8)
    meshes = content["silicone"]["meshes"]
    nodes = [row["nodes"] for row in meshes]
    references = {"gravity": -6.752, "edge": -26.3518, "face": -24.97175}
    titles = {"gravity": "own weight / COMSOL", "edge": "1 N on the edge / COMSOL", "face": "1 N on the face / NGSolve"}
    for key, reference in references.items():
        right.semilogx(nodes, [row[key][1][2] / reference for row in meshes], "o-", label=titles[key])
    _plain_ticks(right, nodes)
    right.axhspan(0.98, 1.02, color="grey", alpha=0.2, label="2 %")
    right.set(xlabel="nodes (P2)", ylabel="deflection at (0, 0, 24) mm / reference")
    right.legend(fontsize=8, loc="lower right")
    return figure


def draw_measured(content: dict[str, Any]) -> plt.Figure:
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8), width_ratios=(1, 1.6), layout="constrained")
    data = content["measured"]
    for place, name in enumerate(("gravity", "load101")):
        for key, color, shift in (("measured_sag_mm", "C0", -0.12), ("simulated_sag_mm", "C1", 0.12)):
            sag = -np.array(data[name][key])[:, 2]
            label = key.split("_")[0] if place == 0 else None
            error = data["zero_scatter_mm"] if key.startswith("measured") else None
            left.errorbar(place + shift, sag.mean(), yerr=error, fmt="s", color=color, label=label, capsize=4)
            left.plot(np.full(3, place + shift), sag, "_", color=color, ms=12)
    left.set(
        xticks=(0, 1), xticklabels=("own weight", "+ 102 g"), ylabel="sag of the tip markers [mm]", xlim=(-0.6, 1.6)
    )
    left.legend()
    swing = data["release"]
    right.plot(swing["times_s"], swing["measured_mm"], label="measured", color="C0")
    right.plot(swing["times_s"], swing["simulated_mm"], label="simulated", color="C1")
    right.set(xlabel="time since release [s]", ylabel="height of the tip markers (mean) [mm]")
    right.legend()
    return figure


def draw_friction(content: dict[str, Any]) -> plt.Figure:
    figure, axes = plt.subplots(figsize=(5.5, 3.8), layout="constrained")
    slope = content["contact"]["slope"]
    angles = np.linspace(0, 47, 200)
    a, mu = np.radians(angles), slope["friction"]
    axes.plot(angles, np.maximum(0, 9.81 * (np.sin(a) - mu * np.cos(a))), "k-", lw=1, label="Coulomb")
    axes.plot(slope["angles"], slope["accelerations"], "o", label="simulated slab")
    axes.axvline(np.degrees(np.arctan(mu)), color="grey", lw=0.8, ls="--", label=f"arctan μ, μ = {mu}")
    axes.set(xlabel="angle of the slope [degree]", ylabel="acceleration [m/s²]")
    axes.legend()
    return figure


FIGURES = {
    "space": draw_space,
    "time": draw_time,
    "beams": draw_beams,
    "measured": draw_measured,
    "friction": draw_friction,
}


def draw_all(content: dict[str, Any], folder: Path) -> list[Path]:
    """Draw every figure as folder/verification_<name>.png."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, draw in FIGURES.items():
        figure = draw(content)
        paths.append(folder / f"verification_{name}.png")
        figure.savefig(paths[-1], dpi=110)
        plt.close(figure)
    return paths
