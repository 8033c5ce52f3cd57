"""Small SVG charts of the estimates of E and ν."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup, escape

from inference.table import ResultRow
from inference.units import format_pascals, format_pascals_range


@dataclass(frozen=True)
class Axis:
    """A range of numbers on a line."""

    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]

    def share(self, value: float) -> float:
        """Return the position of the value, 0 to 1, clipped to the axis."""
        return min(1.0, max(0.0, (value - self.low) / (self.high - self.low)))


def stiffness_axis(rows: Sequence[ResultRow]) -> Axis:
    """Return an axis of log10(E / Pa) that holds all intervals, and 10 kPa to 10 MPa at least."""
    bounds = [math.log10(v) for row in rows for v in (row.youngs_modulus_low, row.youngs_modulus_high) if v]
    low, high = math.floor(min([4.0, *bounds])), math.ceil(max([7.0, *bounds]))
    step = max(1, math.ceil((high - low) / 8))
    return Axis(float(low), float(high), tuple((float(k), format_tick(k)) for k in range(low, high + 1, step)))


def format_tick(exponent: int) -> str:
    """Return 10^exponent pascals as a label."""
    scale, unit = next(((k, u) for k, u in ((9, "GPa"), (6, "MPa"), (3, "kPa")) if exponent >= k), (0, "Pa"))
    return f"{10 ** (exponent - scale):g} {unit}"


def poisson_axis() -> Axis:
    """Return the axis of ν from 0 to ½."""
    return Axis(0.0, 0.5, tuple((value, f"{value:g}") for value in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)))


def stiffness_bar(row: ResultRow, axis: Axis) -> Markup:
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


def poisson_bar(row: ResultRow, axis: Axis) -> Markup:
    """Draw the distribution of ν of one clip with its 90 % interval."""
    assert row.poisson_ratio is not None and row.poisson_ratio_low is not None
    assert row.poisson_ratio_high is not None
    interval = (row.poisson_ratio_low, row.poisson_ratio_high)
    title = f"ν = {row.poisson_ratio:.3f}, 90 % interval {interval[0]:.3f}–{interval[1]:.3f}"
    return _bar(axis, row.poisson_ratio, row.poisson_ratio_std or 0.0, interval, title)


_WIDTH, _CURVE, _HEIGHT, _SIDE = 300, 26, 56, 20  # [px]


def _bar(axis: Axis, centre: float, std: float, interval: tuple[float, float], title: str) -> Markup:
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


def _bell(axis: Axis, centre: float, std: float, x: object, base: float) -> str:
    """Outline of a normal density, as high as the drawing allows at its centre."""
    assert callable(x)
    if std <= 0:
        return ""
    values = [axis.low + (axis.high - axis.low) * k / 80 for k in range(81)]
    values = sorted({*values, *(centre + std * k / 4 for k in range(-12, 13))})
    values = [value for value in values if axis.low <= value <= axis.high]
    points = [(x(v), base - _CURVE * math.exp(-0.5 * ((v - centre) / std) ** 2)) for v in values]
    line = " ".join(f"L{px},{py:.1f}" for px, py in points)
    return f"M{points[0][0]},{base} {line} L{points[-1][0]},{base} Z" if points else ""


def overview_chart(rows: Sequence[ResultRow], *, stiffness: Axis, poisson: Axis) -> Markup:
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


def _cross(number: int, row: ResultRow, x: object, y: object) -> str:
    assert callable(x) and callable(y)
    assert row.youngs_modulus and row.youngs_modulus_low and row.youngs_modulus_high
    centre = (x(math.log10(row.youngs_modulus)), y(row.poisson_ratio))
    heights = (y(row.poisson_ratio_low), y(row.poisson_ratio_high))
    ends = (x(math.log10(row.youngs_modulus_low)), x(math.log10(row.youngs_modulus_high)))
    return (
        f'<a href="#clip-{number}" class="cross"><title>{escape(row.name)}: '
        f"{format_pascals(row.youngs_modulus)}, ν {row.poisson_ratio:.2f}</title>"
        f'<line x1="{ends[0]}" x2="{ends[1]}" y1="{centre[1]}" y2="{centre[1]}"/>'
        f'<line x1="{centre[0]}" x2="{centre[0]}" y1="{heights[0]}" y2="{heights[1]}"/>'
        f'<circle cx="{centre[0]}" cy="{centre[1]}" r="4"/></a>'
    )
