"""The result of a diagnosis: files, and the improved twin."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from jinja2 import Environment, PackageLoader, StrictUndefined

from physconvex.errors import InputError
from physconvex.fem import Scene
from physconvex.gap.light.image_formation import ImageFinding
from physconvex.gap.page import pictures
from physconvex.gap.page.findings import GapFindings
from physconvex.gap.page.video_strip import video_strip
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.io import Picture, html_summary
from physconvex.reduced import ReducedScene


@dataclass(frozen=True, eq=False)
class ImprovedTwin:
    """The base model with the effects, at the fitted values.

    Attributes:
        hypothesis: fit of the motion.
        pictures: called effects of image formation; they move no point.
    """

    hypothesis: Hypothesis
    pictures: tuple[ImageFinding, ...] = ()

    @property
    def scene(self) -> Scene:
        """Full-order scene."""
        return self.hypothesis.model.full_scene(self.hypothesis.values)

    @property
    def reduced_scene(self) -> ReducedScene:
        """Reduced scene."""
        return self.hypothesis.model.reduced_scene(self.hypothesis.values)

    @property
    def values(self) -> dict[str, float]:
        """Parameters and doses by name."""
        motion = {n: float(v) for n, v in zip(self.hypothesis.model.names, self.hypothesis.values, strict=True)}
        return motion | {f"{p.named.name}.{p.named.doses[0].name}": p.named.doses[0].value for p in self.pictures}

    def positions(self) -> Float[np.ndarray, "T P 3"]:
        """Its observed positions [m]."""
        return self.hypothesis.positions


@dataclass(frozen=True, eq=False)
class GapReport(GapFindings):
    """`GapFindings` that can be applied and saved."""

    def _repr_html_(self) -> str:
        """Verdict, shrinkage and doses with their intervals, and a picture of the gap on the body, for a notebook."""
        main = self.how_far[0]
        rows = [
            ("verdict", self.verdict.sentence),
            ("gap shrinks by", f"{main.shrinkage:.0%} ({main.lower:.0%} to {main.upper:.0%}), by {main.data}"),
        ]
        rows += [
            (f"{effect.name}: {dose.name}", f"{dose.value:.4g} {dose.unit} ({dose.lower:.4g} to {dose.upper:.4g})")
            for effect in self.verdict.effects
            for dose in effect.doses
        ]
        body = Picture(pictures.svg_of(pictures.body_map(self.where)), "the gap on the body")
        return html_summary("Diagnosis", rows, pictures=[body], notes=self.verdict.caveats)

    def apply(self) -> ImprovedTwin:
        """The twin with the named effects added.

        Raises:
            InputError: the verdict names no effect.
        """
        if self.verdict.name != "effect":
            raise InputError(
                f"apply: the verdict is {self.verdict.name!r}; expected 'effect'. The best fit is in `best` regardless"
            )
        called = tuple(finding for finding in self.pictures if finding.called)
        moved = {effect.name for effect in self.verdict.effects} & set(self.best.names)
        base = next(h for h in self.hypotheses if not h.effects)
        return ImprovedTwin(self.best if moved else base, called)

    def save(self, folder: Path | str) -> None:
        """Write report.json, report.html and body.ply.

        Raises:
            InputError: the folder cannot be made.
        """
        target = Path(folder)
        try:
            target.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{target}: cannot be made ({error}); choose another folder for the results") from error
        text = json.dumps(self.to_json(), indent=1, allow_nan=False)
        (target / "report.json").write_text(text + "\n", encoding="utf-8")
        pictures.write_body(self.where, target / "body.ply")
        (target / "report.html").write_text(page_of(self), encoding="utf-8")


def page_of(report: GapFindings) -> str:
    """The report as one HTML page, from `templates/report.html`; it needs no other file and no network."""
    environment = Environment(
        loader=PackageLoader("physconvex.gap.page"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters |= {
        "mm": _in_form("{:.3g} mm", 1e3), "percent": _in_form("{:.0%}"), "ringing": _in_form("{:.3g} Hz, ζ = {:.3f}"),
        "ringing_error": _in_form("± {:.2g} Hz, ± {:.2g}"), "digits": lambda value, count: f"{value:.{count}g}",
        "vector": lambda values: ", ".join(f"{x:.2g}" for x in values),
    }  # fmt: skip
    return environment.get_template("report.html").render(report=report, figures=_figures(report))


def _in_form(form: str, factor: float = 1.0) -> Callable[[float | tuple[float, float]], str]:
    """A filter of the template: a number or a pair, times a factor, in a form; a dash if the (first) one is unknown."""

    def shown(value: float | tuple[float, float]) -> str:
        numbers = factor * np.atleast_1d(value)
        return form.format(*numbers) if np.isfinite(numbers[0]) else "–"

    return shown


def _figures(report: GapFindings) -> dict[str, str]:
    """SVG elements and data URIs by name."""
    video = video_strip(report)
    return {
        "budget": pictures.svg_of(pictures.budget(report.where)),
        "timeline": pictures.svg_of(pictures.timeline(report)),
        "body": pictures.png_of(pictures.body_map(report.where)),
        "forest": pictures.svg_of(pictures.forest(report)),
        "confusion": pictures.svg_of(pictures.confusion(report)),
        "shrinkage": pictures.svg_of(pictures.shrinkage_bars(report)),
        "parameters": pictures.svg_of(pictures.parameter_arrows(report)),
        "video": "" if video is None else pictures.png_of(video),
        "image_series": pictures.svg_of(pictures.image_series(report)) if report.pictures else "",
    }
