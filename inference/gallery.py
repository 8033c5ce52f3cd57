"""One self-contained HTML page of results: frames with the found outline, E and ν with their uncertainty."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from inference.charts import Axis, overview_chart, poisson_axis, poisson_bar, stiffness_axis, stiffness_bar
from inference.table import ResultRow
from inference.units import format_pascals, format_pascals_range
from physconvex.io import data_uri

CLIPS_SHOWN = 300
"""Most clips on one page; the tables hold all."""


def write_gallery(out: Path, rows: Sequence[ResultRow]) -> Path:
    """Write `gallery.html` from the rows and the pictures in `clips/`."""
    fine = [row for row in rows if not row.error]
    shown = fine[:CLIPS_SHOWN]
    stiffness, poisson = stiffness_axis(shown), poisson_axis()
    pages = Environment(loader=PackageLoader("inference"), autoescape=True, undefined=StrictUndefined)
    pages.filters["pascals"] = format_pascals
    page = pages.get_template("gallery.html").render(
        fine=len(fine),
        failed=[row for row in rows if row.error],
        overview=overview_chart(shown, stiffness=stiffness, poisson=poisson),
        cards=[_card(out / "clips", row, stiffness, poisson) for row in shown],
    )
    path = out / "gallery.html"
    temporary = out / ".partial-gallery.html"
    temporary.write_text(page + "\n", encoding="utf-8")
    os.replace(temporary, path)
    return path


def _card(clips: Path, row: ResultRow, stiffness: Axis, poisson: Axis) -> dict[str, object]:
    """Content of the page on one clip."""
    assert row.youngs_modulus_low and row.youngs_modulus_high
    strip, weights = clips / f"{row.name}.jpg", clips / f"{row.name}.skinning.png"
    return {
        "row": row,
        "strip": data_uri(strip.read_bytes()) if strip.is_file() else "",
        "weights": data_uri(weights.read_bytes()) if weights.is_file() else "",
        "interval": format_pascals_range(row.youngs_modulus_low, row.youngs_modulus_high),
        "stiffness": stiffness_bar(row, stiffness),
        "poisson": poisson_bar(row, poisson),
        "chips": _chips(row),
    }


def _chips(row: ResultRow) -> list[str]:
    sure = "" if row.foreground_confidence is None else f" ({row.foreground_confidence:.0%} sure)"
    chips = [f"object found by {row.foreground.replace('_', ' ')}{sure}", f"{row.frames_used} frames"]
    return [*chips, f"ρ = {row.density:g} kg/m³", f"L = {row.object_size:g} m", f"{row.fps:g} frames/s"]
