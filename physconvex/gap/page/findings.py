"""The findings of a diagnosis, and their JSON."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np
from pydantic import JsonValue

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.errors.screening import Screened, Screening
from physconvex.gap.judgement.naming import NamedEffect, Verdict
from physconvex.gap.light.image_formation import ImageFinding
from physconvex.gap.location.body_motion import Mode
from physconvex.gap.location.where import Part, Where
from physconvex.gap.options import GapOptions
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.shrinkage import HowFar
from physconvex.gap.thresholds import thresholds_json

FORMAT_VERSION = 1
JsonObject = dict[str, JsonValue]
Content = dict[str, object]  # part of the file, which may hold arrays


@dataclass(frozen=True)
class Provenance:
    """Origin of the result.

    Attributes:
        capture: name of the capture's folder.
        version: version of physconvex.
        nodes: number of nodes of the model's mesh.
        steps_per_frame: time steps of the model.
        numerical_viscosity: E Δt [Pa s] that implicit Euler with this step would add, for comparison.
        fitted, selecting, reporting: frames used for each.
        simulations_failed: effects and runs that cannot be simulated.
        seconds: wall time.
        thresholds: decision thresholds, by group and name (`physconvex.gap.thresholds`).
    """

    capture: str
    version: str
    nodes: int
    steps_per_frame: int
    numerical_viscosity: float
    fitted: tuple[int, ...]
    selecting: tuple[int, ...]
    reporting: tuple[int, ...]
    simulations_failed: tuple[str, ...]
    seconds: float
    thresholds: dict[str, JsonValue] = field(default_factory=thresholds_json)


@dataclass(frozen=True)
class ParameterChange:
    """A base parameter without and with the effects, and its standard errors."""

    name: str
    before: float
    before_error: float
    after: float
    after_error: float


@dataclass(frozen=True, eq=False)
class GapFindings:
    """Location of the gap, the effect that causes it, and its shrinkage with that effect.

    Attributes:
        where: the decomposition.
        verdict: the effect that causes it.
        how_far: shrinkage by held-out data, the first for the frames reserved for the report.
        pictures: results of a video's light for effects of image formation.
        base: the base fit.
        best: the best hypothesis with effects (the base model if none could be tried).
        hypotheses: all fits, best evidence first.
        screening: scores of all effects.
        next_experiment: recording that decides between the remaining effects.
        provenance: origin of the result.
        options: settings.
    """

    where: Where
    verdict: Verdict
    how_far: tuple[HowFar, ...]
    pictures: tuple[ImageFinding, ...]
    base: Baseline
    best: Hypothesis
    hypotheses: tuple[Hypothesis, ...]
    screening: Screening
    next_experiment: str
    provenance: Provenance
    options: GapOptions

    @property
    def parameters(self) -> tuple[ParameterChange, ...]:
        """The base parameters without and with the effects."""
        before = next(h for h in self.hypotheses if not h.effects)
        columns = (before.values, before.errors, self.best.values, self.best.errors)
        rows = zip(before.model.base, *columns, strict=False)  # doses follow in the columns
        return tuple(ParameterChange(name, *map(float, row)) for name, *row in rows)

    def to_json(self) -> JsonObject:
        """The content of report.json (schema: docs/reference/diagnosis_files.md)."""
        main = self.how_far[0]
        content = {
            "format": "physconvex gap report",
            "format_version": FORMAT_VERSION,
            "where": _where_json(self.where),
            "which": {
                "verdict": self.verdict.name,
                **_picked(self.verdict, "sentence", "none_probability"),
                "effects": [_effect_json(effect) for effect in self.verdict.effects],
                "caveats": self.verdict.caveats,
                "screening": [_screened_json(entry) for entry in self.screening.ranked],
                "hypotheses": [{"effects": h.names, "label": h.label, "evidence": h.evidence} for h in self.hypotheses],
            },
            "how_far": {
                **_picked(main, "gap_before", "gap_after", "noise_floor", "shrinkage"),
                "interval": [main.lower, main.upper],
                **_picked(main, "net_shrinkage", "placebo", "placebo_effect", "data"),
                "unit": "m",
                "all": [asdict(part) for part in self.how_far],
                "parameters": [asdict(row) for row in self.parameters],
            },
            "pictures": [_picture_json(finding, self.base.capture.fps) for finding in self.pictures],
            "next_experiment": self.next_experiment,
            "provenance": asdict(self.provenance),
            "options": self.options.to_json(),
        }
        return {key: _plain(value) for key, value in content.items()}


def _plain(value: object) -> JsonValue:
    """The value in JSON types: no arrays and no NumPy numbers, and None in place of a number that is not finite."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    assert value is None or isinstance(value, str | int | float), type(value)
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _picked(thing: object, *names: str) -> Content:
    """Some attributes by name."""
    return {name: getattr(thing, name) for name in names}


def _parts(parts: tuple[Part, ...]) -> list[Content]:
    return [{"name": p.name, "rms": p.value, "interval": [p.lower, p.upper], "unit": "m"} for p in parts]


def _rows(columns: Content) -> list[Content]:
    """A table of columns as one object per row."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _where_json(where: Where) -> Content:
    frames = _rows({
        "frame": range(len(where.times)), "time": where.times, "phase": where.phase_names, "before": where.per_frame,
        "after": where.per_frame_after, "floor": where.per_frame_floor,
    })  # fmt: skip
    return {
        "sources": _parts(where.sources),
        "reduction": None if where.reduction is None else _parts((where.reduction,))[0],
        "phases": _parts(where.phases),
        "regions": _parts(where.regions),
        "frames": frames,
        "points": {"rest": where.points, "rms": where.per_point, "unit": "m"},
        "image": _parts(where.image),
        "modes": [_mode_json(mode) for mode in where.modes],
        "ledger": [
            asdict(entry) | {"units": {"impulse": "N s", "angular_impulse": "N m s", "work": "J"}}
            for entry in where.ledger
        ],
    }


def _picture_json(finding: ImageFinding, fps: float) -> Content:
    series, dose = finding.series, finding.named.doses[0].value
    frames = _rows({
        "frame": series.frames, "time": series.frames / fps, "seen": series.seen, "error": series.errors,
        "foretold": series.at(dose),
    })  # fmt: skip
    told = ("called", "statistic", "gap_before", "gap_after", "noise_floor", "shrinkage", "placebo")
    return {**_effect_json(finding.named), **_picked(finding, *told), "frames": frames}


def _mode_json(mode: Mode) -> Content:
    pairs = {"observed": mode.observed, "observed_error": mode.errors, "base": mode.base, "improved": mode.improved}
    names = ("frequency", "damping_ratio")
    told = {name: dict(zip(names, pair, strict=True)) for name, pair in pairs.items()}
    return {"share": mode.share, **told, "unit": "Hz"}


def _effect_json(effect: NamedEffect) -> Content:
    return {
        **_picked(effect, "name", "variant", "source", "probability"),
        "parameters": [
            {**_picked(d, "name", "unit", "value"), "interval": [d.lower, d.upper], "null": d.null}
            for d in effect.doses
        ],
        "confused_with": effect.confused_with,
    }


def _screened_json(entry: Screened) -> Content:
    return {
        "effect": entry.effect.name,
        **_picked(entry.effect, "variant", "source"),
        **_picked(entry.score, "statistic", "p_value", "visibility", "explained"),
        "power": entry.power,
        "doses": [
            {**_picked(d, "name", "unit"), "estimate": v, "error": e}
            for d, v, e in zip(entry.effect.doses, entry.doses, entry.errors, strict=True)
        ],
    }
