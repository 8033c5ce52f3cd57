"""Pictures of a gap report, as SVG and PNG texts for a page, and the coloured body."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import numpy as np
import trimesh
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from physconvex.gap.base.model import MODULUS, RATIO
from physconvex.gap.location.body_motion import ranges_of
from physconvex.gap.location.where import Where
from physconvex.gap.page.findings import GapFindings
from physconvex.identify import unit_normals

_BLUE, _ORANGE, _GREY = "#2b6ca3", "#d9772b", "#8a8a8a"
_PHASES = {
    "flight": "#e8f1fa", "impact": "#fde3cf", "contact": "#fbeedd", "rebound": "#e6f4ea", "rest": "#eeeeee",
    "early motion": "#e8f1fa", "late motion": "#e6f4ea",
}  # fmt: skip


def _length_unit(values: np.ndarray) -> tuple[float, str]:
    """Factor and unit that make lengths easy to read."""
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    for limit, factor, unit in ((1e-4, 1e6, "µm"), (0.1, 1e3, "mm")):
        if largest < limit:
            return factor, unit
    return 1.0, "m"


def svg_of(figure: Figure) -> str:
    """The figure as an SVG element, without prolog, with text kept as text."""
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "physconvex"}):
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def png_of(figure: Figure, *, dpi: int = 110) -> str:
    """The figure as a data URI."""
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(buffer, format="png", dpi=dpi)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def _figure(width: float, height: float, *panels: int) -> tuple[Figure, list[Axes]]:
    """A figure and its panels, with lines on the left and below alone."""
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = list(figure.subplots(*panels, squeeze=False).flat)
    for one in axes:
        one.spines[["top", "right"]].set_visible(False)
    return figure, axes


def budget(where: Where) -> Figure:
    """Waterfall of the mean squares of the sources."""
    figure, (axes,) = _figure(7, 3.2)
    squares = np.array([part.value**2 for part in where.sources])
    total = max(squares.sum(), 1e-300)
    shares = 100 * squares / total
    left = np.concatenate([[0], np.cumsum(shares)[:-1]])
    names = [part.name for part in where.sources]
    colours = [_GREY, "#b7a16a", "#7d6aa8", "#4a9a92", _BLUE, _ORANGE]
    axes.barh(names, shares, left=left, color=colours)
    for i, (share, start) in enumerate(zip(shares, left, strict=True)):
        if share > 12:  # inside the bar
            axes.text(start + share / 2, i, f"{share:.0f} %", va="center", ha="center", color="white")
        elif start + share < 85:
            axes.text(start + share, i, f" {share:.1f} %", va="center", ha="left")
        else:
            axes.text(start, i, f"{share:.1f} % ", va="center", ha="right")
    axes.invert_yaxis()
    axes.set_xlim(0, 100)
    axes.set_xlabel("share of the mean square distance to the observation [%]")
    return figure


def timeline(report: GapFindings) -> Figure:
    """Gap per frame, before and after, with phases and the use of the frames."""
    where = report.where
    factor, unit = _length_unit(where.per_frame)
    figure, (axes,) = _figure(7, 3)
    step = float(np.diff(where.times).mean()) if len(where.times) > 1 else 1.0
    for phase, first, last in ranges_of(where.phase_names):
        low, high = where.times[first] - step / 2, where.times[last] + step / 2
        axes.axvspan(low, high, color=_PHASES.get(phase, "#ffffff"), lw=0)
        axes.text((low + high) / 2, 1.01, phase, transform=axes.get_xaxis_transform(), ha="center", va="bottom",
                  fontsize=7, rotation=0 if high - low > 3 * step else 40)  # fmt: skip
    axes.plot(where.times, factor * where.per_frame, "o-", ms=3, color=_ORANGE, label="base model")
    if report.best.effects:
        axes.plot(where.times, factor * where.per_frame_after, "s-", ms=3, color=_BLUE, label=f"+ {report.best.label}")
    axes.plot(where.times, factor * where.per_frame_floor, "--", color=_GREY, label="noise and numerical error")
    axes.axvline(where.times[report.provenance.fitted[-1]] + step / 2, color="black", lw=0.8, ls=":")
    axes.text(where.times[report.provenance.fitted[-1]] + step / 2, 0.97, " held out", va="top",
              transform=axes.get_xaxis_transform(), fontsize=8)  # fmt: skip
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"rms distance [{unit}]")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(0, 0.93), framealpha=0.8)
    return figure


def body_map(where: Where) -> Figure:
    """The body's surface from two sides, coloured by the gap."""
    factor, unit = _length_unit(where.per_vertex)
    figure = Figure(figsize=(7, 3.1), layout="constrained")
    colours = _viridis(where.per_vertex)
    low, high = where.vertices.min(0), where.vertices.max(0)
    face = colours[where.faces].mean(1)
    light = 0.65 + 0.35 * np.abs(unit_normals(where.vertices, where.faces) @ np.array([0.3, 0.5, 0.81]))
    face[:, :3] *= light[:, None]
    panels = [figure.add_subplot(1, 2, number, projection="3d") for number in (1, 2)]
    for axes, azimuth in zip(panels, (-60, 120), strict=True):
        axes.add_collection3d(Poly3DCollection(where.vertices[where.faces], facecolors=face, linewidths=0))
        axes.auto_scale_xyz(*np.stack([low, high], axis=1))
        axes.set_box_aspect(np.maximum(high - low, 0.05 * (high - low).max()))
        axes.view_init(18, azimuth)
        axes.set_axis_off()
    scale = Normalize(0, factor * float(where.per_vertex.max()))
    bar = figure.colorbar(ScalarMappable(scale, colormaps["viridis"]), ax=panels, shrink=0.7)
    bar.set_label(f"rms distance [{unit}]")
    return figure


def _viridis(values: np.ndarray) -> np.ndarray:
    return np.asarray(colormaps["viridis"](np.asarray(values) / max(float(np.max(values)), 1e-300)))


def write_body(where: Where, path: Path) -> None:
    """The body's surface as PLY with colours by the gap."""
    used, faces = np.unique(where.faces, return_inverse=True)
    colours = (255 * _viridis(where.per_vertex[used])).round().astype(np.uint8)
    mesh = trimesh.Trimesh(where.vertices[used], faces.reshape(-1, 3), vertex_colors=colours, process=False)
    mesh.export(path)


def forest(report: GapFindings) -> Figure:
    """Screened doses of all effects in units of the smallest dose: estimate and interval."""
    rows = []
    named = {e.label for e in report.best.effects}
    for entry in report.screening.one_per_name:
        for i, dose in enumerate(entry.effect.doses):
            if entry.errors[i] > 0:
                rows.append((f"{entry.effect.label}: {dose.name} [{dose.unit or '–'}]", entry.doses[i] - dose.null,
                             entry.errors[i], entry.effect.label in named))  # fmt: skip
    figure, (axes,) = _figure(7, 0.5 + 0.2 * len(rows))
    for y, (_, value, error, mine) in enumerate(rows):
        ratio = value / error
        axes.plot([ratio - 1.645, ratio + 1.645], [y, y], color=_BLUE if mine else _GREY, lw=2)
        axes.plot(ratio, y, "o", color=_BLUE if mine else _GREY, ms=4)
    axes.axvline(0, color="black", lw=0.8)
    axes.set_yticks(range(len(rows)), [row[0] for row in rows], fontsize=7)
    axes.invert_yaxis()
    axes.set_xscale("symlog", linthresh=3)
    axes.set_xlabel("screened dose over its standard error, 90 % interval")
    return figure


def confusion(report: GapFindings, *, most: int = 14) -> Figure:
    """Cosines between the signatures of the effects in this capture; 1 for indistinguishable effects."""
    entries = report.screening.one_per_name[:most]
    matrix = np.array([[report.screening.similarity(a, b) for b in entries] for a in entries])
    figure = Figure(figsize=(6.4, 5.4), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(matrix, vmin=0, vmax=1, cmap="Blues")
    names = [entry.effect.name for entry in entries]
    axes.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    for i in range(len(names)):
        for j in range(len(names)):
            axes.text(j, i, f"{matrix[i, j]:.1f}".lstrip("0") if matrix[i, j] < 0.95 else "1", ha="center", va="center",
                      fontsize=6, color="white" if matrix[i, j] > 0.6 else "black")  # fmt: skip
    figure.colorbar(image, ax=axes, shrink=0.7, label="|cosine| of the signatures")
    return figure


def shrinkage_bars(report: GapFindings) -> Figure:
    """Shrinkage with interval, and that of the placebo, by held-out data."""
    figure, (axes,) = _figure(7, 2.4)
    for i, part in enumerate(report.how_far):
        value = np.clip(part.shrinkage, -1, 1)
        low, high = np.clip([part.lower, part.upper], -1, 1)
        axes.barh(i - 0.18, 100 * value, 0.34, color=_BLUE, label="best effect" if i == 0 else None)
        axes.plot([100 * low, 100 * high], [i - 0.18] * 2, color="black", lw=1.5)
        if np.isfinite(part.placebo):
            axes.barh(i + 0.18, 100 * np.clip(part.placebo, -1, 1), 0.34, color=_GREY,
                      label=f"placebo: {part.placebo_effect}" if i == 0 else None)  # fmt: skip
    axes.set_yticks(range(len(report.how_far)), [p.data.replace(", ", "\n") for p in report.how_far], fontsize=8)
    axes.axvline(0, color="black", lw=0.8)
    axes.set_xlim(-105, 105)
    axes.invert_yaxis()
    axes.set_xlabel("share of the gap above noise that is removed [%], cut off at −100")
    axes.legend(fontsize=8, loc="lower left")
    return figure


def image_series(report: GapFindings) -> Figure:
    """Statistics of the pictures frame by frame, and their prediction by the fitted effects."""
    figure, panels = _figure(7, 0.4 + 2.0 * len(report.pictures), len(report.pictures))
    for axes, finding in zip(panels, report.pictures, strict=True):
        series, dose = finding.series, finding.named.doses[0]
        times = 1e3 * series.frames / report.base.capture.fps
        axes.errorbar(times, series.seen, 1.645 * series.errors, fmt="o", color=_ORANGE, ms=3, lw=1, label="seen")
        axes.plot(times, series.at(dose.value), color=_BLUE, label=f"{dose.name} {dose.value:.3g} {dose.unit}")
        axes.axhline(0, color="black", lw=0.8)
        axes.set_title(f"{finding.named.name}: {'called' if finding.called else 'not called'}", fontsize=9)
        axes.set_ylabel(finding.statistic.replace(", ", ",\n"), fontsize=7)
        axes.legend(fontsize=7)
    panels[-1].set_xlabel("time [ms]")
    return figure


def parameter_arrows(report: GapFindings) -> Figure:
    """E and ν before and after."""
    rows = [r for r in report.parameters if r.name in (MODULUS, RATIO)]
    figure, panels = _figure(7, 1.8, 1, max(len(rows), 1))
    for axes, row in zip(panels, rows, strict=False):
        log = row.name.startswith("log10")
        told = ((row.before, row.before_error, _ORANGE), (row.after, row.after_error, _BLUE))
        for y, (value, deviation, colour) in enumerate(told):
            error = min(deviation, 3.0)  # an undetermined value extends beyond the picture
            ends = np.array([value - 1.645 * error, value + 1.645 * error])
            axes.plot(10**ends if log else ends, [y, y], color=colour, lw=2)
            axes.plot(10**value if log else value, y, "o", color=colour)
        axes.set_yticks([0, 1], ["before", "after"])
        axes.set_ylim(1.6, -0.6)
        axes.set_xlabel("Young's modulus [Pa]" if log else "Poisson's ratio")
        axes.ticklabel_format(axis="x", style="sci", scilimits=(-2, 4))
    return figure
