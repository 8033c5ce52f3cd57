"""One self-contained HTML page of results: frames with the found outline, charts of E and ν with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from inference.table import ResultRow
from inference.units import format_pascals, format_pascals_range
from physconvex.io import data_uri, whole_file

CLIPS_SHOWN = 300
"""Most clips on one page; the tables hold all."""


def write_gallery(out: Path, rows: Sequence[ResultRow]) -> Path:
    """Write `gallery.html` from the rows and the pictures in `clips/`."""
    fine = [row for row in rows if not row.error]
    shown = fine[:CLIPS_SHOWN]
    stiffness, poisson = _stiffness_axis(shown), _poisson_axis()
    pages = Environment(loader=PackageLoader("inference"), autoescape=True, undefined=StrictUndefined)
    pages.filters["pascals"] = format_pascals
    page = pages.get_template("gallery.html").render(
        fine=len(fine),
        failed=[row for row in rows if row.error],
        overview=_overview_chart(shown, stiffness=stiffness, poisson=poisson),
        cards=[_card(out / "clips", row, stiffness, poisson) for row in shown],
    )
    path = out / "gallery.html"
    with whole_file(path) as partial:
        partial.write_text(page + "\n", encoding="utf-8")
    return path


def _card(clips: Path, row: ResultRow, stiffness: _Axis, poisson: _Axis) -> dict[str, object]:
    """Content of the page on one clip."""
    assert row.youngs_modulus_low and row.youngs_modulus_high
    strip, weights = clips / f"{row.name}.jpg", clips / f"{row.name}.skinning.png"
    return {
        "row": row,
        "strip": data_uri(strip.read_bytes()) if strip.is_file() else "",
        "weights": data_uri(weights.read_bytes()) if weights.is_file() else "",
        "interval": format_pascals_range(row.youngs_modulus_low, row.youngs_modulus_high),
        "stiffness": _stiffness_bar(row, stiffness),
        "poisson": _poisson_bar(row, poisson),
        "chips": _chips(row),
    }


def _chips(row: ResultRow) -> list[str]:
    sure = "" if row.foreground_confidence is None else f" ({row.foreground_confidence:.0%} sure)"
    chips = [f"object found by {row.foreground.replace('_', ' ')}{sure}", f"{row.frames_used} frames"]
    return [*chips, f"ρ = {row.density:g} kg/m³", f"L = {row.object_size:g} m", f"{row.fps:g} frames/s"]


@dataclass(frozen=True)
class _Axis:
    """A range of numbers on a line."""

    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]

    def share(self, value: float) -> float:
        """Return the position of the value, 0 to 1, clipped to the axis."""
        return min(1.0, max(0.0, (value - self.low) / (self.high - self.low)))


def _stiffness_axis(rows: Sequence[ResultRow]) -> _Axis:
    """Return an axis of log10(E / Pa) that holds all intervals, and 10 kPa to 10 MPa at least."""
    bounds = [math.log10(v) for row in rows for v in (row.youngs_modulus_low, row.youngs_modulus_high) if v]
    low, high = math.floor(min([4.0, *bounds])), math.ceil(max([7.0, *bounds]))
    step = max(1, math.ceil((high - low) / 8))
    return _Axis(float(low), float(high), tuple((float(k), _tick(k)) for k in range(low, high + 1, step)))


def _tick(exponent: int) -> str:
    """10^exponent pascals as a label."""
    scale, unit = next(((k, u) for k, u in ((9, "GPa"), (6, "MPa"), (3, "kPa")) if exponent >= k), (0, "Pa"))
    return f"{10 ** (exponent - scale):g} {unit}"


def _poisson_axis() -> _Axis:
    """Return the axis of ν from 0 to ½."""
    return _Axis(0.0, 0.5, tuple((value, f"{value:g}") for value in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)))


def _stiffness_bar(row: ResultRow, axis: _Axis) -> Markup:
    """Draw the distribution of E of one clip with its 90 % interval."""
    assert row.youngs_modulus and row.youngs_modulus_low and row.youngs_modulus_high
    return _bar(
        axis,
        math.log10(row.youngs_modulus),
        row.log10_youngs_modulus_std or 0.0,
        (math.log10(row.youngs_modulus_low), math.log10(row.youngs_modulus_high)),
        f"E = {format_pascals(row.youngs_modulus)}, 90 % interval "
        f"{format_pascals_range(row.youngs_modulus_low, row.youngs_modulus_high)}",
    )


def _poisson_bar(row: ResultRow, axis: _Axis) -> Markup:
    """Draw the distribution of ν of one clip with its 90 % interval."""
    assert row.poisson_ratio is not None and row.poisson_ratio_low is not None
    assert row.poisson_ratio_high is not None
    interval = (row.poisson_ratio_low, row.poisson_ratio_high)
    title = f"ν = {row.poisson_ratio:.3f}, 90 % interval {interval[0]:.3f}–{interval[1]:.3f}"
    return _bar(axis, row.poisson_ratio, row.poisson_ratio_std or 0.0, interval, title)


_WIDTH, _CURVE, _HEIGHT, _SIDE = 300, 26, 56, 20  # [px]


def _bar(axis: _Axis, centre: float, std: float, interval: tuple[float, float], title: str) -> Markup:
    def x(value: float) -> float:
        return round(_SIDE + axis.share(value) * (_WIDTH - 2 * _SIDE), 1)

    base = _CURVE + 4.0
    length = max(2.0, x(interval[1]) - x(interval[0]))
    ticks = "".join(
        f'<line class="tick" x1="{x(v)}" x2="{x(v)}" y1="{base + 7}" y2="{base + 11}"/>'
        f'<text x="{x(v)}" y="{base + 22}">{escape(label)}</text>'
        for v, label in axis.ticks
    )
    return Markup(
        f'<svg class="bar" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img"><title>{escape(title)}</title>'
        f'<path class="density" d="{_bell(axis, centre, std, x, base)}"/>'
        f'<line class="axis" x1="{_SIDE}" x2="{_WIDTH - _SIDE}" y1="{base + 7}" y2="{base + 7}"/>{ticks}'
        f'<rect class="interval" x="{x(interval[0])}" width="{length:.1f}" '
        f'y="{base + 1}" height="5" rx="2.5"/>'
        f'<circle class="median" cx="{x(centre)}" cy="{base + 3.5}" r="4"/></svg>'
    )


def _bell(axis: _Axis, centre: float, std: float, x: Callable[[float], float], base: float) -> str:
    """Outline of a normal density, as high as the drawing allows at its centre."""
    if std <= 0:
        return ""
    values = [axis.low + (axis.high - axis.low) * k / 80 for k in range(81)]
    values = sorted({*values, *(centre + std * k / 4 for k in range(-12, 13))})
    values = [value for value in values if axis.low <= value <= axis.high]
    points = [(x(v), base - _CURVE * math.exp(-0.5 * ((v - centre) / std) ** 2)) for v in values]
    line = " ".join(f"L{px},{py:.1f}" for px, py in points)
    return f"M{points[0][0]},{base} {line} L{points[-1][0]},{base} Z" if points else ""


def _overview_chart(rows: Sequence[ResultRow], *, stiffness: _Axis, poisson: _Axis) -> Markup:
    """Draw every clip as a cross of its two 90 % intervals; each links to its card."""
    width, height, left, bottom = 860, 300, 44, 34

    def x(value: float) -> float:
        return round(left + stiffness.share(value) * (width - left - 24), 1)

    def y(value: float) -> float:
        return round(10 + (1 - poisson.share(value)) * (height - bottom - 10), 1)

    grid = "".join(
        f'<line class="grid" x1="{x(v)}" x2="{x(v)}" y1="10" y2="{height - bottom}"/>'
        f'<text x="{x(v)}" y="{height - bottom + 16}">{escape(label)}</text>'
        for v, label in stiffness.ticks
    ) + "".join(
        f'<line class="grid" x1="{left}" x2="{width - 24}" y1="{y(v)}" y2="{y(v)}"/>'
        f'<text class="left" x="{left - 8}" y="{y(v) + 4}">{label}</text>'
        for v, label in poisson.ticks
    )
    crosses = "".join(_cross(number, row, x, y) for number, row in enumerate(rows))
    axes = f'<text class="name" x="{(width + left) / 2}" y="{height - 3}">Young’s modulus E</text>'
    axes += f'<text class="name" transform="translate(11 {(height - bottom) / 2}) rotate(-90)">ν</text>'
    return Markup(f'<svg class="overview" viewBox="0 0 {width} {height}" role="img">{grid}{axes}{crosses}</svg>')


def _cross(number: int, row: ResultRow, x: Callable[[float], float], y: Callable[[float], float]) -> str:
    assert row.youngs_modulus and row.youngs_modulus_low and row.youngs_modulus_high
    assert row.poisson_ratio is not None and row.poisson_ratio_low is not None and row.poisson_ratio_high is not None
    left, middle, right = (
        x(math.log10(value)) for value in (row.youngs_modulus_low, row.youngs_modulus, row.youngs_modulus_high)
    )
    bottom, centre, top = map(y, (row.poisson_ratio_low, row.poisson_ratio, row.poisson_ratio_high))
    return (
        f'<a href="#clip-{number}" class="cross"><title>{escape(row.name)}: '
        f"{format_pascals(row.youngs_modulus)}, ν {row.poisson_ratio:.2f}</title>"
        f'<line x1="{left}" x2="{right}" y1="{centre}" y2="{centre}"/>'
        f'<line x1="{middle}" x2="{middle}" y1="{bottom}" y2="{top}"/>'
        f'<circle cx="{middle}" cy="{centre}" r="4"/></a>'
    )
