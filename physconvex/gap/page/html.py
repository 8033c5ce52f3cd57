"""The report as one self-contained HTML page, from `templates/report.html`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from physconvex.gap.page import pictures
from physconvex.gap.page.findings import GapFindings
from physconvex.gap.page.video_strip import video_strip

_UNKNOWN = "–"


def _digits(value: float, count: int) -> str:
    return f"{value:.{count}g}"


def _millimetres(value: float) -> str:
    return f"{1e3 * value:.3g} mm" if np.isfinite(value) else _UNKNOWN


def _percent(share: float) -> str:
    return f"{share:.0%}" if np.isfinite(share) else _UNKNOWN


def _ringing(pair: tuple[float, float]) -> str:
    return f"{pair[0]:.3g} Hz, ζ = {pair[1]:.3f}" if np.isfinite(pair[0]) else _UNKNOWN


def _ringing_error(pair: tuple[float, float]) -> str:
    return f"± {pair[0]:.2g} Hz, ± {pair[1]:.2g}" if np.isfinite(pair[0]) else _UNKNOWN


def _vector(values: Sequence[float]) -> str:
    return ", ".join(f"{x:.2g}" for x in values)


def _figures(report: GapFindings) -> dict[str, str]:
    """SVG elements and data URIs by name."""
    found = {
        "budget": pictures.svg_of(pictures.budget(report.where)),
        "timeline": pictures.svg_of(pictures.timeline(report)),
        "body": pictures.png_of(pictures.body_map(report.where)),
        "forest": pictures.svg_of(pictures.forest(report)),
        "confusion": pictures.svg_of(pictures.confusion(report)),
        "shrinkage": pictures.svg_of(pictures.shrinkage_bars(report)),
        "parameters": pictures.svg_of(pictures.parameter_arrows(report)),
    }
    video = video_strip(report)
    found["video"] = "" if video is None else pictures.png_of(video)
    found["image_series"] = pictures.svg_of(pictures.image_series(report)) if report.pictures else ""
    return found


def write_html(report: GapFindings, path: Path) -> None:
    """Write the page; it needs no other file and no network."""
    environment = Environment(
        loader=PackageLoader("physconvex.gap.page"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters |= {
        "mm": _millimetres, "percent": _percent, "digits": _digits, "ringing": _ringing,
        "ringing_error": _ringing_error, "vector": _vector,
    }  # fmt: skip
    page = environment.get_template("report.html").render(report=report, figures=_figures(report))
    path.write_text(page, encoding="utf-8")
