"""Means over objects and Markdown tables of an evaluation, with the paper's own numbers beside."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import cast

import numpy as np

from train.paper.published import (
    ABLATION,
    LOG10_ERRORS,
    METHODS,
    OBJECTS,
    OBSERVED_PSNR,
    POISSON_ERRORS,
    PublishedMeans,
)
from train.paper.published_way import WAYS
from train.paper.rows import ObjectRow, PaperPart

_WAYS = {
    "constant": "constant guess",
    "network": "network alone",
    "published_way": "published way, run here",
    "published_own_steps": "the same, our time steps",
    "published_own_optimiser": "the same, our optimiser",
    "published_own_both": "the same, our steps and optimiser",
    "convex_twin": "convex twin",
    "corrected": "corrected",
    "given_mesh": "corrected, given mesh",
}
_ABLATED = re.compile(r"convex_K(\d+)_M(\d+)")
_SCORES = {"psnr": ".2f", "ssim": ".4f", "psnr_object": ".2f", "fovvdp": ".2f"}
_PRINTED = ("psnr", "ssim", "fovvdp")  # by the paper
_FOLLOWED, _ITSELF, _RECONSTRUCTION = "followed", "truth_itself", "reconstruction"
_FROM_IMAGES = (*WAYS, "convex_twin", "corrected")  # their time includes the reconstruction
PUBLISHED = (
    "*Published*: printed in the paper (arXiv 2602.18886), on its authors' own objects, simulations and views, on one "
    "NVIDIA RTX A6000; E in decades. These rows cannot be compared one by one with those above them."
)


def _label(part: str) -> str:
    others = {_FOLLOWED: "corrected, with its rigid drift", _ITSELF: "truth of half the nodes"}
    return (_WAYS | others).get(part, part)


@dataclass(frozen=True)
class WayMeans:
    """Of one way of fitting, over the objects where it succeeded.

    Attributes:
        log10_error, poisson_error: mean |Δ log10 E| and |Δν|.
        process_seconds: processor time from the images on [s].
        objects: their number.
        coverage_90: share of `intervals` 90 % intervals of E and ν that hold the truth; None of none.
        convexes: mean number of primitives; None without pictures.
    """

    log10_error: float
    poisson_error: float
    process_seconds: float
    objects: int
    coverage_90: float | None
    intervals: int
    convexes: float | None


@dataclass(frozen=True)
class ReconstructionMeans:
    """Of the reconstructions: primitives, PSNR of the first images [dB], |error of volume|, processor time [s]."""

    convexes: float
    psnr: float
    volume_error: float | None
    process_seconds: float


Pictures = dict[str, dict[str, dict[str, dict[str, float]]]]


@dataclass
class Summary:
    """Means over the objects.

    Attributes:
        objects: their number.
        identification: by way; those of the ablation are named convex_KK_MM.
        pictures: scores by way, stretch of the motion and view.
        changes: distances by change [m].
        failures: object, method and error.
        reconstruction: None without any.
    """

    objects: int
    identification: dict[str, WayMeans]
    pictures: Pictures
    changes: dict[str, dict[str, float]]
    failures: list[str]
    reconstruction: ReconstructionMeans | None


def _made(rows: Sequence[ObjectRow]) -> list[str]:
    """The parts of any object."""
    return list(dict.fromkeys(part for row in rows for part in row.parts))


def _ways(rows: Sequence[ObjectRow]) -> list[str]:
    """The columns, in the order of `_WAYS`."""
    return [way for way in _WAYS if way in _made(rows)]


def _ablated(rows: Sequence[ObjectRow]) -> list[str]:
    return [part for part in _made(rows) if _ABLATED.fullmatch(part)]


def _parts(rows: Sequence[ObjectRow], name: str, key: str) -> list[PaperPart]:
    """A part of each object where it was made and holds that entry."""
    return [part for row in rows if (part := row.with_part(name, key)) is not None]


def summary(rows: Sequence[ObjectRow]) -> Summary:
    """Means over the objects: |Δlog10 E|, |Δν|, coverage, pictures, changes, time, primitives; failures by name."""
    identification, pictures = {}, Pictures()
    for way in [*_ways(rows), *_ablated(rows)]:
        means = _way_means(rows, way)
        if means is not None:
            identification[way] = means
            _add_pictures(pictures, way, _parts(rows, way, "errors"))
    _add_pictures(pictures, _FOLLOWED, _parts(rows, _FOLLOWED, "pictures"))
    _add_pictures(pictures, _ITSELF, [row.truth_itself for row in rows])
    corrected = _parts(rows, "corrected", "changes")
    changes = dict.fromkeys(change for part in corrected for change in part["changes"])  # some truths may lack them
    return Summary(
        objects=len(rows),
        identification=identification,
        pictures=pictures,
        changes={change: _mean_change(corrected, change) for change in changes},
        failures=[
            f"{row.object}: {name}: {part['failure']}"
            for name in _made(rows)
            for row in rows
            if (part := row.with_part(name, "failure")) is not None
        ],
        reconstruction=_reconstruction_means(_parts(rows, _RECONSTRUCTION, "convexes")),
    )


def _way_means(rows: Sequence[ObjectRow], way: str) -> WayMeans | None:
    good = [(row, part) for row in rows if (part := row.with_part(way, "errors")) is not None]
    if not good:
        return None
    errors = np.abs([part["errors"] for _, part in good]).mean(axis=0)
    covered = [c for _, part in good for c in part.get("covered", ()) if c is not None]
    convexes = [part["convexes"] for _, part in good if "convexes" in part]
    return WayMeans(
        log10_error=float(errors[0]),
        poisson_error=float(errors[1]),
        process_seconds=float(np.mean([_seconds(row, way) for row, _ in good])),
        objects=len(good),
        coverage_90=float(np.mean(covered)) if covered else None,
        intervals=len(covered),
        convexes=float(np.mean(convexes)) if convexes else None,
    )


def _seconds(row: ObjectRow, way: str) -> float:
    """Processor time of a way [s], that of the reconstruction that it begins with included."""
    ablated = _ABLATED.fullmatch(way)
    begins = f"{_RECONSTRUCTION}_K{ablated[1]}" if ablated else _RECONSTRUCTION
    first = row.parts.get(begins, row.parts.get(_RECONSTRUCTION, {}))
    return row.parts[way]["process_seconds"] + (
        first.get("process_seconds", 0.0) if ablated or way in _FROM_IMAGES else 0.0
    )


def _mean_change(corrected: Sequence[PaperPart], change: str) -> dict[str, float]:
    values = [part["changes"][change] for part in corrected if change in part["changes"]]
    return {
        "rms_m": float(np.mean([value["rms_m"] for value in values])),
        "change_rms_m": float(np.mean([value["change_rms_m"] for value in values])),
    }


def _reconstruction_means(found: Sequence[PaperPart]) -> ReconstructionMeans | None:
    if not found:
        return None
    volumes = [abs(one["volume_error"]) for one in found if "volume_error" in one]
    return ReconstructionMeans(
        convexes=float(np.mean([one["convexes"] for one in found])),
        psnr=float(np.mean([one["first_images"]["psnr"] for one in found])),
        volume_error=float(np.mean(volumes)) if volumes else None,
        process_seconds=float(np.mean([one["process_seconds"] for one in found])),
    )


def _add_pictures(target: Pictures, way: str, good: Sequence[PaperPart]) -> None:
    for stretch, view in product(("observed", "future"), ("front", "others")):
        views = [part.get("pictures", {}).get(stretch, {}) for part in good]
        found = [dict(scores[view]) for scores in views if view in scores]
        means = {}
        for name in _SCORES:
            values = [cast(float, one[name]) for one in found if one.get(name) is not None]
            if values and (name == "fovvdp" or len(values) == len(found)):
                means[name] = float(np.mean(values))
        if found:
            target.setdefault(way, {}).setdefault(stretch, {})[view] = means


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    first, *others = ["|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|" for cells in (heads, *rows)]
    return [first, "|" + "---|" * len(heads), *others]


def _section(title: str, *lines: str) -> list[str]:
    return ["", f"## {title}", "", *lines]


def _cell(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def markdown(rows: Sequence[ObjectRow], note: str) -> str:
    """The tables, as a page."""
    told = summary(rows)
    lines = ["# Tables", "", note, "", "Errors are fit less truth; E in decades (log10)."]
    lines += _means(told) + _identification(rows) + _intervals(rows) + _pictures(told) + _by_object(rows)
    changes = [[n, f"{1e3 * c['rms_m']:.1f}", f"{1e3 * c['change_rms_m']:.1f}"] for n, c in told.changes.items()]
    heads = ["change", "distance from the truth [mm]", "how far the change goes [mm]"]
    lines += _section("Generalisation", *_table(heads, changes)) + _ablation(told)
    if told.failures:
        lines += _section("Failures", *(f"- {text}" for text in told.failures))
    return "\n".join(lines) + "\n"


def _means(told: Summary) -> list[str]:
    """One row for each way, and the published ones."""
    heads = ["", "objects", "E", "ν", "90 % intervals that hold the truth", "processor time [s]", "primitives"]
    cells = [
        [
            _label(way),
            str(means.objects),
            f"{means.log10_error:.3f}",
            f"{means.poisson_error:.3f}",
            "–" if means.coverage_90 is None else f"{means.coverage_90:.2f} of {means.intervals}",
            f"{means.process_seconds:.0f}",
            _cell(means.convexes, ".0f"),
        ]
        for way, means in told.identification.items()
        if way in _WAYS
    ]
    cells += [
        [f"*{name}, published*", str(len(OBJECTS)), _cell(one.log10_error, ".2f"), _cell(one.poisson_error, ".2f"),
         "–", "–" if one.minutes is None else f"{60 * one.minutes:.0f} (GPU)", _cell(one.primitives, "d")]
        for name, one in METHODS.items()
    ]  # fmt: skip
    lines = _section("Means of absolute errors", *_table(heads, cells), "", PUBLISHED)
    if told.reconstruction is not None:
        made = told.reconstruction
        volume = "" if made.volume_error is None else f", its volume {100 * made.volume_error:.1f} % off in the mean"
        lines += [
            "",
            f"The body is reconstructed from frame 0 of all cameras, with {made.convexes:.0f} convexes in the mean "
            f"({made.psnr:.1f} dB){volume}, in {made.process_seconds:.0f} s of a processor, which the times of what "
            "works from images include.",
        ]
    return lines


def _identification(rows: Sequence[ObjectRow]) -> list[str]:
    ways = _ways(rows)
    cells = []
    for row in rows:
        truth = list(row.truth.values())
        cells.append([row.object, f"{truth[0]:.2f}, {truth[1]:.2f}", *(_pair(row.parts.get(way)) for way in ways)])
    published = [
        [name, f"{modulus:.2f}", f"{ratio:.2f}", f"{quality:.2f}"]
        for name, modulus, ratio, quality in zip(OBJECTS, LOG10_ERRORS, POISSON_ERRORS, OBSERVED_PSNR, strict=True)
    ]
    return [
        *_section("Identification", *_table(["object", "log10 E, ν", *map(_label, ways)], cells)),
        "",
        "*Published*, of PhysConvex on its own objects: absolute errors of E and ν, PSNR of the observed frames.",
        "",
        *_table(["object", "E", "ν", "PSNR"], published),
    ]


def _pair(part: PaperPart | None) -> str:
    """Errors of a way for one object; a dash where it was not run."""
    if part is None:
        return "–"
    return "failed" if "failure" in part else f"{part['errors'][0]:+.3f} / {part['errors'][1]:+.3f}"


def _intervals(rows: Sequence[ObjectRow]) -> list[str]:
    """Half widths of the 90 % intervals, and whether they hold the truth."""
    ways = [way for way in _ways(rows) if _parts(rows, way, "intervals_90")]
    if not ways:
        return []
    cells = [[row.object, *(_interval(row.with_part(way, "intervals_90")) for way in ways)] for row in rows]
    what = ("Half of the 90 % intervals of E and ν; ! where one does not hold the truth.", "")
    return _section("Intervals", *what, *_table(["object", *map(_label, ways)], cells))


def _interval(part: PaperPart | None) -> str:
    if part is None:
        return "–"
    pairs = zip(part["intervals_90"], part["covered"], strict=True)
    return " / ".join(
        "none" if ends is None else f"{0.5 * (ends[1] - ends[0]):.3f}{'' if covered else ' !'}"
        for ends, covered in pairs
    )


def _pictures(told: Summary) -> list[str]:
    cells = [
        [_label(way), stretch, view, *(format(s[n], form) if n in s else "–" for n, form in _SCORES.items())]
        for way, parts in told.pictures.items()
        if not _ABLATED.fullmatch(way)
        for stretch, views in parts.items()
        for view, s in views.items()
    ]
    cells += [
        [f"*{name}, published*", stretch, "–", *_printed(getattr(one, stretch), ("psnr", "ssim", "", "fovvdp"))]
        for name, one in METHODS.items()
        for stretch in ("observed", "future")
    ]
    heads = ["", "frames", "views", "PSNR", "SSIM", "PSNR on the object", "FovVideoVDP"]
    return _section("Pictures", *_table(heads, cells))


def _printed(values: Sequence[float], columns: Sequence[str] = _PRINTED) -> list[str]:
    stated = dict(zip(_PRINTED, values, strict=True))
    return [format(stated[name], _SCORES[name]) if name else "–" for name in columns]


def _by_object(rows: Sequence[ObjectRow]) -> list[str]:
    """PSNR of the front view, observed and future."""
    ways = [way for way in (*_ways(rows), _FOLLOWED) if _parts(rows, way, "pictures")]
    if not ways:
        return []
    cells = [[row.object, *(_two_psnr(row.with_part(way, "pictures")) for way in ways)] for row in rows]
    what = ("PSNR of the front view [dB], observed frames / future ones.", "")
    return _section("Pictures by object", *what, *_table(["object", *map(_label, ways)], cells))


def _two_psnr(part: PaperPart | None) -> str:
    if part is None:
        return "–"
    found = [part["pictures"].get(stretch, {}).get("front", {}).get("psnr") for stretch in ("observed", "future")]
    return " / ".join(_cell(value, ".1f") for value in found)


def _ablation(told: Summary) -> list[str]:
    """Convex twins of other K and M, each beside the published row."""
    pairs = {(int(found[1]), int(found[2])): way for way in told.identification if (found := _ABLATED.fullmatch(way))}
    if not pairs:
        return []
    cells = []
    for (points, weights), way in sorted(pairs.items()):
        means, pictures = told.identification[way], told.pictures.get(way, {})
        scores = [
            format(front[name], _SCORES[name]) if name in front else "–"
            for stretch in ("observed", "future")
            for front in [pictures.get(stretch, {}).get("front", {})]
            for name in _PRINTED
        ]
        errors = [f"{means.log10_error:.3f}", f"{means.poisson_error:.3f}"]
        cost = [_cell(means.convexes, ".0f"), f"{means.process_seconds:.0f}"]
        cells.append([str(points), str(weights), str(means.objects), *scores, *errors, *cost])
        if (points, weights) in ABLATION:
            cells.append(["", "", "*published*", *_published_row(ABLATION[points, weights])])
    heads = ["K", "M", "objects"]
    heads += [f"{name}, {stretch}" for stretch in ("observed", "future") for name in ("PSNR", "SSIM", "FovVideoVDP")]
    heads += ["E", "ν", "primitives", "processor time [s]"]
    what = ("Convex twins; K points per convex, M skinning weights; pictures of the front view.", "")
    return _section("Ablation", *what, *_table(heads, cells))


def _published_row(one: PublishedMeans) -> list[str]:
    errors = [_cell(one.log10_error, ".2f"), _cell(one.poisson_error, ".2f")]
    time = "–" if one.minutes is None else f"{60 * one.minutes:.0f} (GPU)"
    return [*_printed(one.observed), *_printed(one.future), *errors, _cell(one.primitives, "d"), time]
