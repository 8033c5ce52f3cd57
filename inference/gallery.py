"""One self-contained HTML page to look at: frames with the found outline, E and ν with their uncertainty."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from html import escape
from pathlib import Path

from inference.charts import Axis, overview_chart, poisson_axis, poisson_bar, stiffness_axis, stiffness_bar
from inference.table import ResultRow
from inference.units import format_pascals, format_pascals_range

__all__ = ["CLIPS_SHOWN", "write_gallery"]

CLIPS_SHOWN = 300
"""Most clips on one page; the tables hold all."""


def write_gallery(out: Path, rows: Sequence[ResultRow]) -> Path:
    """Write `gallery.html` from the rows and the pictures in `clips/`."""
    fine = [row for row in rows if not row.error]
    shown, failed = fine[:CLIPS_SHOWN], [row for row in rows if row.error]
    axes = stiffness_axis(shown), poisson_axis()
    parts = [_head(len(fine), len(failed), len(shown))]
    if shown:
        parts.append(f"<figure>{overview_chart(shown, stiffness=axes[0], poisson=axes[1])}</figure>")
    if failed:
        parts.append(_failures(failed))
    parts += [_card(out, number, row, *axes) for number, row in enumerate(shown)]
    page = f'<!doctype html><html lang="en"><head><meta charset="utf-8">{_STYLE}'
    page += f"<title>physconvex predictions</title></head><body><main>{''.join(parts)}</main></body></html>\n"
    path = out / "gallery.html"
    temporary = out / ".partial-gallery.html"
    temporary.write_text(page, encoding="utf-8")
    os.replace(temporary, path)
    return path


def _head(fine: int, failed: int, shown: int) -> str:
    text = f"{fine} clip{'s' if fine != 1 else ''} predicted"
    text += f", {failed} could not be read" if failed else ""
    text += f" (the first {shown} are shown)" if shown < fine else ""
    return (
        f'<header><h1>Predictions</h1><p>{text}. All numbers: <a href="predictions.csv">predictions.csv</a>, '
        'how they were made: <a href="run.json">run.json</a>.</p><p class="legend">Bars and crosses are '
        "calibrated 90 % intervals, dots medians, curves normal with the stated deviation; "
        '<span class="outline">▬</span> is the outline of the object as it was '
        "found: where it is wrong, so is the prediction.</p></header>"
    )


def _failures(rows: Sequence[ResultRow]) -> str:
    items = "".join(f"<li>{escape(row.error)}</li>" for row in rows)
    return f'<section class="failed"><h2>Not predicted</h2><ul>{items}</ul></section>'


def _card(out: Path, number: int, row: ResultRow, stiffness: Axis, poisson: Axis) -> str:
    assert row.youngs_modulus and row.youngs_modulus_low and row.youngs_modulus_high
    strip = _image(out / "clips" / f"{row.name}.jpg", "strip", f"frames of {row.name}")
    weights = _image(out / "clips" / f"{row.name}.skinning.png", "weights", "skinning weights")
    weights = f'<div><p class="caption">skinning weights, middle section</p>{weights}</div>' if weights else ""
    interval = format_pascals_range(row.youngs_modulus_low, row.youngs_modulus_high)
    ratio = f"{row.poisson_ratio_low:.2f}–{row.poisson_ratio_high:.2f}"
    return (
        f'<article id="clip-{number}"><h2>{escape(row.path)}</h2>{strip}<div class="facts">'
        f'<div><p class="value">E = {format_pascals(row.youngs_modulus)} <small>{interval}</small></p>'
        f"{stiffness_bar(row, stiffness)}</div>"
        f'<div><p class="value">ν = {row.poisson_ratio:.2f} <small>{ratio}</small></p>'
        f"{poisson_bar(row, poisson)}</div>{weights}</div>{_chips(row)}</article>"
    )


def _chips(row: ResultRow) -> str:
    sure = "" if row.foreground_confidence is None else f" ({row.foreground_confidence:.0%} sure)"
    chips = [f"object found by {row.foreground.replace('_', ' ')}{sure}", f"{row.frames_used} frames"]
    chips += [f"ρ = {row.density:g} kg/m³", f"L = {row.object_size:g} m", f"{row.fps:g} frames/s"]
    text = "".join(f"<li>{escape(chip)}</li>" for chip in chips)
    text += "".join(f'<li class="assumed">assumed {escape(part)}</li>' for part in row.assumed.split("; ") if part)
    text += "".join(f'<li class="warning">{escape(part)}</li>' for part in row.warnings.split("; ") if part)
    return f'<ul class="chips">{text}</ul>'


def _image(path: Path, kind: str, alternative: str) -> str:
    if not path.is_file():
        return ""
    mime = "image/png" if path.suffix == ".png" else "image/jpeg"
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img class="{kind}" alt="{escape(alternative)}" src="data:{mime};base64,{data}">'


_STYLE = """<style>
:root { color-scheme: light dark; --paper: light-dark(#f6f5f2, #17181a); --card: light-dark(#fff, #212327);
  --ink: light-dark(#22252a, #e6e6e3);
  --soft: light-dark(#6b7078, #9aa0a8); --line: light-dark(#dddad3, #383b40);
  --blue: light-dark(#2767b2, #6fa8ec); --pale: light-dark(#cfe0f4, #29405c);
  --amber: light-dark(#8a5a00, #e7b558);
  --red: light-dark(#a32626, #f08a8a); }
body { margin: 0; background: var(--paper); color: var(--ink); font: 15px/1.5 system-ui, sans-serif; }
main { max-width: 1090px; margin: 0 auto; padding: 28px 20px 60px; }
h1 { font-size: 28px; margin: 0 0 4px; } h2 { font-size: 14px; font-weight: 600; margin: 0 0 10px;
  overflow-wrap: anywhere; } header p { margin: 2px 0; } .legend { color: var(--soft); }
.outline { color: #00b4e6; }
a { color: var(--blue); }
figure, article, .failed { background: var(--card); border: 1px solid var(--line); border-radius: 10px;
  padding: 16px; margin: 18px 0; }
article:target { outline: 2px solid var(--blue); }
.strip { max-width: 100%; display: block; border-radius: 4px; }
.facts { display: flex; flex-wrap: wrap; gap: 8px 22px; align-items: center; margin-top: 12px; }
.value { margin: 0; font-size: 19px; font-variant-numeric: tabular-nums; }
.value small { color: var(--soft); font-size: 13px; margin-left: 6px; }
.bar { width: 300px; max-width: 100%; display: block; } .weights { display: block; width: 350px; max-width: 100%; }
.caption { margin: 0 0 6px; font-size: 12.5px; color: var(--soft); }
svg text { font-size: 10px; fill: var(--soft); text-anchor: middle; } svg text.left { text-anchor: end; }
svg .name { font-size: 11px; fill: var(--ink); }
.density { fill: var(--pale); } .axis, .tick { stroke: var(--soft); stroke-width: 1; }
.interval { fill: var(--blue); opacity: .55; }
.median { fill: var(--blue); stroke: var(--card); stroke-width: 1.5; }
.grid { stroke: var(--line); } .cross line { stroke: var(--blue); stroke-width: 1.5; opacity: .45; }
.cross circle { fill: var(--blue); } .cross:hover line { opacity: 1; stroke-width: 2.5; }
.overview { width: 100%; display: block; }
.chips { display: flex; flex-wrap: wrap; gap: 6px;
  list-style: none; padding: 0; margin: 12px 0 0; font-size: 12.5px; }
.chips li { border: 1px solid var(--line); border-radius: 99px; padding: 1px 9px; color: var(--soft); }
.chips .assumed { color: var(--amber); border-color: currentColor; }
.chips .warning { color: var(--red); border-color: currentColor; border-radius: 8px; }
.failed { border-color: var(--red); } .failed li { overflow-wrap: anywhere; }
</style>"""
