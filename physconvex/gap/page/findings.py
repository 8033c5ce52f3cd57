"""What a diagnosis found, and its JSON."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from physconvex.gap.base.baseline import Baseline
from physconvex.gap.errors.screening import Screening
from physconvex.gap.judgement.verdict_input import Verdict
from physconvex.gap.light.image_formation import ImageFinding
from physconvex.gap.location.vibration import Mode
from physconvex.gap.location.where import Part, Where
from physconvex.gap.options import GapOptions
from physconvex.gap.search.hypothesis import Hypothesis
from physconvex.gap.shrinkage.how_far import HowFar

__all__ = ["FORMAT_VERSION", "GapFindings", "Provenance"]

FORMAT_VERSION = 1


@dataclass(frozen=True)
class Provenance:
    """How the result came about.

    Attributes:
        capture: name of the capture's folder.
        version: of physconvex.
        nodes: of the model's mesh.
        steps_per_frame: time steps of the model.
        numerical_viscosity: E Δt [Pa s] that implicit Euler with this step would add, for comparison.
        fitted, selecting, reporting: frames used for each.
        simulations_failed: what could not be simulated.
        seconds: wall time.
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


@dataclass(frozen=True, eq=False)
class GapFindings:
    """Where the gap lies, which effect causes it, and how far it shrinks once that is added.

    Attributes:
        where: the decomposition.
        verdict: which.
        how_far: shrinkage by held-out data, the first for the frames that served nothing else.
        pictures: of a video, what its light says of effects of image formation.
        base: the base fit.
        best: the best hypothesis with effects (the base model where none could be tried).
        hypotheses: all that were fitted, best evidence first.
        screening: scores of all effects.
        next_experiment: what would decide between what is left.
        provenance: how it came about.
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

    def parameters(self) -> list[dict[str, Any]]:
        """Base parameters before and after the effects were added, with standard errors."""
        before = next(h for h in self.hypotheses if not h.effects)
        out = []
        for index, name in enumerate(before.model.base):
            out.append(
                {
                    "name": name,
                    "before": float(before.values[index]),
                    "before_error": float(before.errors[index]),
                    "after": float(self.best.values[index]),
                    "after_error": float(self.best.errors[index]),
                }
            )
        return out

    def to_json(self) -> dict[str, Any]:
        """The content of report.json (schema: docs/reference/diagnosis_files.md)."""
        main = self.how_far[0]
        return {
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
                "all": [_cleaned(asdict(part)) for part in self.how_far],
                "parameters": self.parameters(),
            },
            "pictures": [_picture_json(finding, self.base.capture.fps) for finding in self.pictures],
            "next_experiment": self.next_experiment,
            "provenance": asdict(self.provenance),
            "options": asdict(self.options),
        }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _cleaned(values: dict[str, Any]) -> dict[str, Any]:
    return {k: _number(v) if isinstance(v, float) else v for k, v in values.items()}


def _parts(parts: tuple[Part, ...]) -> list[dict[str, Any]]:
    return [{"name": p.name, "rms": p.value, "interval": [p.lower, p.upper], "unit": "m"} for p in parts]


def _where_json(where: Where) -> dict[str, Any]:
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


def _picture_json(finding: ImageFinding, fps: float) -> dict[str, Any]:
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


def _mode_json(mode: Mode) -> dict[str, Any]:
    def pair(values: tuple[float, float]) -> dict[str, float | None]:
        return {"frequency": _number(values[0]), "damping_ratio": _number(values[1])}

    return {
        "share": mode.share,
        "observed": pair(mode.observed),
        "observed_error": pair(mode.errors),
        "base": pair(mode.base),
        "improved": pair(mode.improved),
        "unit": "Hz",
    }


def _effect_json(effect: Any) -> dict[str, Any]:
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


def _screened_json(entry: Any) -> dict[str, Any]:
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
