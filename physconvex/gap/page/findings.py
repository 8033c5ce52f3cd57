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
                "sentence": self.verdict.sentence,
                "none_probability": self.verdict.none_probability,
                "effects": [_effect_json(e) for e in self.verdict.effects],
                "caveats": list(self.verdict.caveats),
                "screening": [_screened_json(s) for s in self.screening.ranked],
                "hypotheses": [
                    {"effects": list(h.names), "label": h.label, "evidence": h.evidence} for h in self.hypotheses
                ],
            },
            "how_far": {
                "gap_before": main.gap_before,
                "gap_after": main.gap_after,
                "noise_floor": main.noise_floor,
                "shrinkage": main.shrinkage,
                "interval": [main.lower, main.upper],
                "net_shrinkage": main.net_shrinkage,
                "placebo": _number(main.placebo),
                "placebo_effect": main.placebo_effect,
                "data": main.data,
                "unit": "m",
                "all": [{k: _number(v) for k, v in asdict(part).items()} for part in self.how_far],
                "parameters": [asdict(row) for row in self.parameters],
            },
            "pictures": [_picture_json(finding, self.base.capture.fps) for finding in self.pictures],
            "next_experiment": self.next_experiment,
            "provenance": asdict(self.provenance),
            "options": self.options.to_json(),
        }
        return {key: _plain(value) for key, value in content.items()}


def _plain(value: object) -> JsonValue:
    """The value in JSON types: no arrays and no NumPy numbers."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    assert value is None or isinstance(value, str | int | float), type(value)
    return value


def _number(value: object) -> object:
    """None in place of a number that is not finite."""
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _parts(parts: tuple[Part, ...]) -> list[Content]:
    return [{"name": p.name, "rms": p.value, "interval": [p.lower, p.upper], "unit": "m"} for p in parts]


def _where_json(where: Where) -> Content:
    frames = [
        {"frame": i, "time": float(t), "phase": phase, "before": _number(b), "after": _number(a), "floor": _number(f)}
        for i, (t, phase, b, a, f) in enumerate(
            zip(where.times, where.phase_names, where.per_frame, where.per_frame_after, where.per_frame_floor,
                strict=True)
        )
    ]  # fmt: skip
    return {
        "sources": _parts(where.sources),
        "reduction": None if where.reduction is None else _parts((where.reduction,))[0],
        "phases": _parts(where.phases),
        "regions": _parts(where.regions),
        "frames": frames,
        "points": {"rest": where.points.tolist(), "rms": where.per_point.tolist(), "unit": "m"},
        "image": _parts(where.image),
        "modes": [_mode_json(mode) for mode in where.modes],
        "ledger": [
            asdict(entry) | {"units": {"impulse": "N s", "angular_impulse": "N m s", "work": "J"}}
            for entry in where.ledger
        ],
    }


def _picture_json(finding: ImageFinding, fps: float) -> Content:
    series, dose = finding.series, finding.named.doses[0].value
    frames = [
        {"frame": int(t), "time": t / fps, "seen": float(seen), "error": float(error), "foretold": float(told)}
        for t, seen, error, told in zip(series.frames, series.seen, series.errors, series.at(dose), strict=True)
    ]
    return {
        **_effect_json(finding.named),
        "called": finding.called,
        "statistic": finding.statistic,
        "gap_before": finding.gap_before,
        "gap_after": finding.gap_after,
        "noise_floor": finding.noise_floor,
        "shrinkage": finding.shrinkage,
        "placebo": _number(finding.placebo),
        "frames": frames,
    }


def _mode_json(mode: Mode) -> Content:
    def pair(values: tuple[float, float]) -> Content:
        return {"frequency": _number(values[0]), "damping_ratio": _number(values[1])}

    return {
        "share": mode.share,
        "observed": pair(mode.observed),
        "observed_error": pair(mode.errors),
        "base": pair(mode.base),
        "improved": pair(mode.improved),
        "unit": "Hz",
    }


def _effect_json(effect: NamedEffect) -> Content:
    return {
        "name": effect.name,
        "variant": effect.variant,
        "source": effect.source,
        "probability": effect.probability,
        "parameters": [
            {"name": d.name, "unit": d.unit, "value": d.value, "interval": [d.lower, d.upper], "null": d.null}
            for d in effect.doses
        ],
        "confused_with": list(effect.confused_with),
    }


def _screened_json(entry: Screened) -> Content:
    score = entry.score
    return {
        "effect": entry.effect.name,
        "variant": entry.effect.variant,
        "source": entry.effect.source,
        "statistic": score.statistic,
        "p_value": score.p_value,
        "visibility": score.visibility,
        "explained": score.explained,
        "power": entry.power,
        "doses": [
            {"name": d.name, "unit": d.unit, "estimate": float(v), "error": float(e)}
            for d, v, e in zip(entry.effect.doses, entry.doses, entry.errors, strict=True)
        ],
    }
