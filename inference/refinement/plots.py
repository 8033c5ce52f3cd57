"""One picture of a fit: markers seen and modelled, the search, the estimates."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from inference.refinement.result import Refinement
from physconvex.io import Capture

__all__ = ["write_plots"]

_SHOWN = 6  # markers


def write_plots(found: Refinement, capture: Capture, path: Path) -> None:
    """Write the picture."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7), layout="constrained")
    axes = figure.subplots(2, 2)
    _draw_heights(axes[0, 0], found, capture)
    _draw_distance(axes[0, 1], found, capture)
    _draw_history(axes[1, 0], found)
    _draw_estimates(axes[1, 1], found)
    figure.savefig(path, dpi=110)


def _draw_heights(axis, found: Refinement, capture: Capture) -> None:  # type: ignore[no-untyped-def]
    tracks, motion = capture.tracks(), found.motion
    if tracks is None:
        lowest, middle = motion.vertices[..., 2].min(1), motion.vertices[..., 2].mean(1)
        axis.plot(motion.times, 1e3 * middle, label="mean of the surface")
        axis.plot(motion.times, 1e3 * lowest, label="lowest point")
        axis.legend(fontsize=8)
    else:
        chosen = np.linspace(0, len(tracks.rest) - 1, min(_SHOWN, len(tracks.rest))).astype(int)
        for number, p in enumerate(chosen):
            axis.plot(motion.times, 1e3 * motion.markers[:, p, 2], color=f"C{number}", lw=1)
            axis.plot(motion.times, 1e3 * tracks.positions[:, p, 2], "o", color=f"C{number}", ms=3)
    axis.axvspan((found.observed_frames - 0.5) / capture.fps, motion.times[-1], color="0.92")
    axis.set(xlabel="time [s]", ylabel="height [mm]", title="model (lines), seen (dots); grey: not fitted")


def _draw_distance(axis, found: Refinement, capture: Capture) -> None:  # type: ignore[no-untyped-def]
    tracks = capture.tracks()
    if tracks is None:
        axis.axis("off")
        lines = [f"{source}: rms {value:.2f} σ" for source, value in found.residual_rms.items()]
        axis.text(0.0, 0.95, "\n".join(lines), va="top", fontsize=9, transform=axis.transAxes)
        return
    distance = np.linalg.norm(found.motion.markers - tracks.positions, axis=-1)
    seen = np.isfinite(distance).any(1)
    rms = np.sqrt(np.nanmean(distance[seen] ** 2, axis=1))
    axis.plot(found.motion.times[seen], 1e3 * rms, "k-o", ms=3, label="rms distance")
    axis.axhline(1e3 * float(np.sqrt(3) * np.median(tracks.sigma)), color="C3", lw=1, label="stated noise")
    axis.axvspan((found.observed_frames - 0.5) / capture.fps, found.motion.times[-1], color="0.92")
    axis.set(xlabel="time [s]", ylabel="distance [mm]", title="markers, seen less model")
    axis.legend(fontsize=8)


def _draw_history(axis, found: Refinement) -> None:  # type: ignore[no-untyped-def]
    axis.semilogy([i.misfit for i in found.history], "k-o", ms=3, label="last search")
    runs = [run.misfit for run in found.full_runs if np.isfinite(run.misfit)]
    if runs:
        axis.semilogy(runs, "C1-s", ms=4, label="full model")
    axis.set(xlabel="step", ylabel="misfit", title="search")
    axis.legend(fontsize=8)


def _draw_estimates(axis, found: Refinement) -> None:  # type: ignore[no-untyped-def]
    axis.axis("off")
    lines = [f"E = {found.youngs_modulus:.4g} Pa", f"ν = {found.poisson_ratio:.4f}", ""]
    for e in found.estimates:
        interval = "none" if e.interval is None else f"[{e.interval[0]:.4g}, {e.interval[1]:.4g}]"
        lines.append(f"{e.name} = {e.value:.5g}   90 %: {interval}")
    lines += ["", f"χ² per degree of freedom {found.reduced_chi_square:.3g}", *found.identifiability.sentences]
    axis.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=8, transform=axis.transAxes, wrap=True)
