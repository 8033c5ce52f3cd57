"""The report as one self-contained HTML page."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np

from physconvex.gap.page import pictures
from physconvex.gap.page.findings import GapFindings
from physconvex.gap.page.video_strip import video_strip

__all__ = ["write_html"]

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#1c2733;max-width:60rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem}h2{font-size:1.1rem;margin-top:2.2rem;border-bottom:1px solid #d5dde5}
.verdict{background:#eef4fa;border-left:6px solid #2b6ca3;padding:1rem 1.2rem;font-size:1.15rem}
.verdict.none{border-color:#3a8f5a;background:#eef7f1}.verdict.unknown{border-color:#d9772b;background:#fdf3ea}
.verdict.inconclusive{border-color:#8a8a8a;background:#f3f3f3}
table{border-collapse:collapse;font-size:.88rem}
td,th{padding:.2rem .7rem;text-align:left;border-bottom:1px solid #e4e9ee}
td.n{text-align:right;font-variant-numeric:tabular-nums}svg,img{max-width:100%;height:auto}
.note{color:#5a6672;font-size:.9rem}ul{padding-left:1.2rem}
"""


def _table(head: list[str], rows: list[list[str]]) -> str:
    top = "".join(f"<th>{escape(h)}</th>" for h in head)
    body = "".join(
        "<tr>" + "".join(f"<td{' class=n' if i else ''}>{escape(c)}</td>" for i, c in enumerate(row)) + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _section(title: str, note: str, content: str) -> str:
    return f"<h2>{escape(title)}</h2><p class=note>{escape(note)}</p>{content}"


def _millimetres(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{1e3 * value:.3g} mm"


def _effects(report: GapFindings) -> str:
    rows = []
    for effect in report.verdict.effects:
        for i, dose in enumerate(effect.doses):
            rows.append([
                f"{effect.name} {effect.variant}".strip() if i == 0 else "",
                f"{effect.probability:.0%}" if i == 0 else "",
                dose.name,
                f"{dose.value:.4g} {dose.unit}",
                f"{dose.lower:.4g} to {dose.upper:.4g}",
                ", ".join(effect.confused_with) if i == 0 else "",
            ])  # fmt: skip
    if not rows:
        return "<p>No effect is named.</p>"
    return _table(["effect", "probability", "dose", "value", "interval", "may be confused with"], rows)


def _how_far(report: GapFindings) -> str:
    rows = [
        [
            part.data,
            _millimetres(part.gap_before),
            _millimetres(part.gap_after),
            _millimetres(part.noise_floor),
            f"{part.shrinkage:.0%} ({part.lower:.0%} to {part.upper:.0%})",
            "–" if not np.isfinite(part.placebo) else f"{part.placebo:.0%}",
        ]
        for part in report.how_far
    ]
    return _table(["data", "gap before", "after", "floor", "shrinkage", "placebo"], rows)


def _modes(report: GapFindings) -> str:
    def text(pair: tuple[float, float]) -> str:
        return "–" if not np.isfinite(pair[0]) else f"{pair[0]:.3g} Hz, ζ = {pair[1]:.3f}"

    rows = [
        [
            f"{number + 1} ({mode.share:.0%} of the deformation)",
            text(mode.observed),
            "–" if not np.isfinite(mode.errors[0]) else f"± {mode.errors[0]:.2g} Hz, ± {mode.errors[1]:.2g}",
            text(mode.base),
            text(mode.improved),
        ]
        for number, mode in enumerate(report.where.modes)
    ]
    if not rows:
        return "<p>Too few markers or frames, or a picture: nothing to tell.</p>"
    return _table(["shape", "observed", "error", "base model", "with the best effects"], rows)


def _ledger(report: GapFindings) -> str:
    rows = [
        [
            f"{e.phase}, frames {e.frames[0]} to {e.frames[1]}",
            ", ".join(f"{x:.2g}" for x in e.impulse),
            f"{e.impulse_error:.1g}",
            ", ".join(f"{x:.2g}" for x in e.angular_impulse),
            f"{e.work:.2g}",
        ]
        for e in report.where.ledger
    ]
    if not rows:
        return "<p>Of free bodies with markers only.</p>"
    return _table(["phase", "impulse x, y, z [N s]", "±", "angular impulse [N m s]", "work [J]"], rows)


def _parameters(report: GapFindings) -> str:
    rows = [
        [
            row.name,
            f"{row.before:.4g} ± {row.before_error:.2g}",
            f"{row.after:.4g} ± {row.after_error:.2g}",
        ]
        for row in report.parameters
    ]
    return _table(["parameter", "before", "after"], rows)


def _screening(report: GapFindings) -> str:
    rows = []
    for entry in report.screening.ranked:
        rows.append([
            entry.effect.label,
            entry.effect.source,
            f"{entry.score.statistic:.1f}",
            f"{entry.score.p_value:.1e}",
            f"{entry.score.visibility:.2f}",
            f"{entry.score.explained:.0%}",
        ])  # fmt: skip
    head = ["effect", "source", "score", "p", "visibility", "explains"]
    return "<details><summary>All scores</summary>" + _table(head, rows) + "</details>"


def _provenance(report: GapFindings) -> str:
    p = report.provenance
    failed = ", ".join(p.simulations_failed) or "none"
    rows = [
        ["capture", p.capture],
        ["physconvex", p.version],
        ["mesh nodes", str(p.nodes)],
        ["time steps per frame", str(p.steps_per_frame)],
        ["E Δt: viscosity that implicit Euler would add", f"{p.numerical_viscosity:.3g} Pa s"],
        ["frames fitted", f"{p.fitted[0]} to {p.fitted[-1]}"],
        ["frames that chose between effects", f"{p.selecting[0]} to {p.selecting[-1]}"],
        ["frames that served nothing but the report", f"{p.reporting[0]} to {p.reporting[-1]}"],
        ["simulations that failed", failed],
        ["seconds", f"{p.seconds:.0f}"],
        ["largest allowed chance of a false call", f"{report.options.significance:g}"],
    ]
    return _table(["", ""], rows)


def _image_formation(report: GapFindings) -> list[str]:
    """The section of what the pictures' light shows, where there is a video."""
    if not report.pictures:
        return []
    rows = [
        [
            finding.effect.name,
            "called" if finding.called else "not called",
            f"{dose.value:.3g} {dose.unit}",
            f"{dose.lower:.3g} to {dose.upper:.3g}",
            f"{finding.gap_before:.2g} → {finding.gap_after:.2g} ({finding.noise_floor:.2g})",
            f"{finding.shrinkage:.0%}",
            "–" if not np.isfinite(finding.placebo) else f"{finding.placebo:.0%}",
        ]
        for finding in report.pictures
        for dose in finding.named.doses
    ]
    head = ["effect", "", "dose", "interval", "gap before → after (floor)", "shrinkage", "placebo"]
    note = "Effects that move no point: fitted to every other frame, judged on the frames between."
    return [_section("Which: pictures", note, pictures.svg_of(pictures.image_series(report)) + _table(head, rows))]


def _video(report: GapFindings) -> list[str]:
    """The section with the video, where there is one."""
    figure = video_strip(report)
    if figure is None:
        return []
    note = (
        "The first image, carried along as the models move the body; grey where it does not tell what is seen. Last "
        "rows: brightness of the video less the model's, red darker, blue brighter."
    )
    return [_section("Where: video", note, f'<img alt="video and models" src="{pictures.png_of(figure)}">')]


def write_html(report: GapFindings, path: Path) -> None:
    """Write the page; it needs no other file and no network."""
    verdict = report.verdict
    caveats = "".join(f"<li>{escape(c)}</li>" for c in verdict.caveats)
    reduction = report.where.reduction
    extra = () if reduction is None else (replace(reduction, name="beside, of the reduced twin alone: reduction"),)
    phases = _table(
        ["part", "rms distance", "interval"],
        [
            [p.name, _millimetres(p.value), f"{_millimetres(p.lower)} to {_millimetres(p.upper)}"]
            for p in (*report.where.sources, *extra, *report.where.phases, *report.where.regions, *report.where.image)
        ],
    )
    sections = [
        _section("Where: sources", "What the distance between the plain model and the observation is made of.",
                 pictures.svg_of(pictures.budget(report.where))),
        _section("Where: time", "Phases are the model's. Right of the dotted line nothing was fitted.",
                 pictures.svg_of(pictures.timeline(report))),
        _section("Where: body", "The plain model's distance, carried from the observed points to the surface.",
                 f'<img alt="body coloured by the gap" src="{pictures.png_of(pictures.body_map(report.where))}">'),
        *_video(report),
        _section("Where: numbers", "Root mean squares; 90 % intervals by resampling blocks of frames.", phases),
        _section("Where: vibrations", "Shapes that the observed deformation is made of, each fitted by a damped sine: "
                 "frequency and damping ratio.", _modes(report)),
        _section("Where: ledger", "What the observed body received and the base model's did not.", _ledger(report)),
        _section("Which: effects", "Fitted on the first frames, chosen on later ones.", _effects(report)),
        *_image_formation(report),
        _section("Which: doses", "What the residual asks for, effect by effect, before any of them is fitted.",
                 pictures.svg_of(pictures.forest(report)) + _screening(report)),
        _section("Which: what looks alike here", "A dark square: this recording cannot tell the two apart.",
                 pictures.svg_of(pictures.confusion(report))),
        _section("How far", "On frames that were not fitted. The placebo is an effect the residual does not ask for, "
                 "fitted in the same way.", pictures.svg_of(pictures.shrinkage_bars(report)) + _how_far(report)),
        _section("Material before and after", "What the plain model's constants had absorbed.",
                 pictures.svg_of(pictures.parameter_arrows(report)) + _parameters(report)),
        _section("Next experiment", "", f"<p>{escape(report.next_experiment)}</p>"),
        _section("Provenance", "", _provenance(report)),
    ]  # fmt: skip
    page = (
        "<!doctype html><html lang=en><head><meta charset=utf-8>"
        f"<title>Gap of {escape(report.provenance.capture)}</title><style>{_STYLE}</style></head><body>"
        f"<h1>Gap between model and observation: {escape(report.provenance.capture)}</h1>"
        f'<div class="verdict {verdict.name}">{escape(verdict.sentence)}</div><ul>{caveats}</ul>'
        + "".join(sections)
        + "</body></html>\n"
    )
    path.write_text(page, encoding="utf-8")
