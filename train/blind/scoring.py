"""The score of a blind test: opened seals compared with the answers."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_gen import COMMITMENT, ControlScore, digest, same_class, score_controls
from physconvex import InputError
from train.blind.metrics import Bin, Proportion, area_under_roc, calibration_error, proportion, reliability
from train.blind.rows import Row, scored_row

VISIBLE = 10.0  # smallest visibility that the figures include
_LADDER = (1.5, 3.0, 10.0, 30.0)  # accuracy is reported at these


@dataclass(frozen=True)
class Bank:
    """Files of one bank: captures, seal, answers.json and the folder of the oracle's results, if it exists."""

    captures: Path
    seal: Path
    answers: Path
    oracle: Path | None = None

    @property
    def name(self) -> str:
        """Name of the folder that contains the captures' folder."""
        return self.captures.resolve().parent.name

    def removed_by_truth(self, capture: str) -> float:
        """The oracle's result for a capture; NaN without one."""
        file = None if self.oracle is None else self.oracle / f"{capture}.json"
        value = json.loads(file.read_text(encoding="utf-8"))["shrinkage"] if file and file.exists() else None
        return float("nan") if value is None else float(value)


@dataclass(frozen=True)
class EffectScore:
    """Captures that hide one effect, at all visibilities: class ranked first, called, and leading effects."""

    name: str
    right_first: Proportion
    called: Proportion
    first: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class VisibilityScore:
    """Captures of one effect with about this visibility: nearest to this step of the ladder."""

    visibility: float
    right_first: Proportion
    called: Proportion
    wrong_calls: Proportion


@dataclass(frozen=True)
class Bias:
    """Error of a parameter: mean and standard deviation, median and 90th percentile of its absolute values."""

    mean: float
    deviation: float
    median: float
    most: float


@dataclass(frozen=True)
class BankScore:
    """Result of a blind test. Figures of single effects are for visibility 10 and more.

    Attributes:
        captures: number of captures with an answer.
        errors: number without one.
        undrawn: number that cannot be simulated.
        top_1, top_2: share whose effect leads the fits, or is among the first two that do; exact names.
        top_1_merged, top_2_merged: the same with the declared confusion classes merged.
        called: share with the verdict "effect" and the right class.
        calls_right: share of all such verdicts, at any visibility or without effects, with a hidden first class.
        shuffled: `top_1_merged` with labels permuted at random over the captures with one effect: the chance level.
        false_alarms: share of captures without an effect with the verdict "effect".
        outside_not_called: share of captures with an effect outside the dictionary whose verdict is not "effect".
        outside_unknown: share of those whose verdict is "unknown".
        unknown_auroc: how well `Row.unknown_score` separates these from visible single effects.
        recall, precision: for captures with two effects: share of these in the best fit, and share of hidden ones among
            its effects, classes merged; `two` is their number.
        two: number of captures with two effects.
        median_shrinkage, median_placebo: share of the held-out gap that the best effects, and a wrong one, remove.
        share_of_oracle: median of the shrinkage over the oracle's, if that removes something.
        oracles: number of these captures.
        median_dose_error: for correctly named effects, |told - hidden| over |hidden|.
        doses_covered: share of their doses whose 90 % interval contains the hidden one.
        calibration_error: for the probability of the class of the first effect that is named or remains possible; a
            numerical one is right if nothing is hidden and nothing is called.
        reliability: its bins.
        bias: error of log10 E and ν after the diagnosis, for single effects and for captures without any.
        by_effect, by_visibility: rows.
        confusion: hidden effect, effect that leads the fits ("-": none), number.
        failures: captures without the desired answer.
        controls: their answers.
        rows: one per capture.
    """

    captures: int
    errors: int
    undrawn: int
    top_1: Proportion
    top_2: Proportion
    top_1_merged: Proportion
    top_2_merged: Proportion
    called: Proportion
    calls_right: Proportion
    shuffled: float
    false_alarms: Proportion
    outside_not_called: Proportion
    outside_unknown: Proportion
    unknown_auroc: float
    two: int
    recall: float
    precision: float
    median_shrinkage: float
    median_placebo: float
    share_of_oracle: float
    oracles: int
    median_dose_error: float
    doses_covered: Proportion
    calibration_error: float
    reliability: tuple[Bin, ...]
    bias: dict[str, Bias]
    by_effect: tuple[EffectScore, ...]
    by_visibility: tuple[VisibilityScore, ...]
    confusion: tuple[tuple[str, str, int], ...]
    failures: tuple[str, ...]
    controls: tuple[ControlScore, ...]
    rows: tuple[Row, ...]


def opened(captures: Path, seal: Path) -> list[dict[str, Any]]:
    """The labels of a bank.

    Raises:
        InputError: the seal does not belong to the captures.
    """
    sealed = json.loads(seal.read_text(encoding="utf-8"))
    commitment = json.loads((captures / COMMITMENT).read_text(encoding="utf-8"))
    if digest(sealed["labels"], sealed["salt"]) != commitment["sha256"]:
        raise InputError(f"{seal}: its hash differs from {captures / COMMITMENT}; it belongs to other captures")
    return list(json.loads(sealed["labels"]))


def score_banks(*banks: Bank) -> BankScore:
    """Open the seals and compare; captures of several banks count together.

    Raises:
        InputError: a seal does not belong to the captures, or answers differ from their hash.
    """
    rows: list[Row] = []
    controls: list[ControlScore] = []
    undrawn = 0
    for bank in banks:
        labels, given = opened(bank.captures, bank.seal), json.loads(bank.answers.read_text(encoding="utf-8"))
        if digest(json.dumps(given["answers"], indent=1), "") != given["sha256"]:
            raise InputError(f"{bank.answers}: its hash differs from its content; the answers were changed")
        by_name = {answer["capture"]: answer for answer in given["answers"]}
        undrawn += sum("failed" in label for label in labels)
        labels = [label for label in labels if "failed" not in label]
        without = given.get("without", ())
        rows += [
            scored_row(
                label, by_name.get(label["capture"]), without,
                oracle=bank.removed_by_truth(label["capture"]), bank=bank.name,
            )
            for label in labels
            if not label.get("control")
        ]  # fmt: skip
        controls += score_controls(labels, by_name)
    return score_rows(rows, tuple(controls), undrawn)


def score_rows(rows: Sequence[Row], controls: tuple[ControlScore, ...], undrawn: int) -> BankScore:
    """All figures, from captures with labels.

    Args:
        rows: one per capture, controls aside.
        controls: their answers.
        undrawn: number of captures that cannot be simulated.
    """
    answered = [row for row in rows if row.verdict != "error"]
    single = [row for row in answered if row.single]
    visible = [row for row in single if row.visibility >= VISIBLE]
    outside = [row for row in answered if row.outside]
    free = [row for row in answered if not row.truth]
    two = [row for row in answered if len(row.truth) > 1]
    oracles = [row.shrinkage / row.oracle for row in visible if row.oracle > 0 and np.isfinite(row.shrinkage)]
    doses = [row.dose for row in visible if row.alarm and row.dose is not None]
    told = [row for row in answered if np.isfinite(row.probability) and not row.outside]
    bins = reliability([r.probability for r in told], [r.told_right for r in told])

    def share(part: Sequence[Row], hit: Callable[[Row], bool]) -> Proportion:
        return proportion([hit(row) for row in part])

    return BankScore(
        captures=len(answered),
        errors=len(rows) - len(answered),
        undrawn=undrawn,
        top_1=share(visible, lambda r: r.first[:1] == r.truth),
        top_2=share(visible, lambda r: r.truth[0] in r.first[:2]),
        top_1_merged=share(visible, lambda r: r.right_first),
        top_2_merged=share(visible, lambda r: r.among(2)),
        called=share(visible, lambda r: r.called),
        calls_right=share([r for r in answered if r.alarm and not r.outside], lambda r: r.called),
        shuffled=_shuffled(visible),
        false_alarms=share(free, lambda r: r.alarm),
        outside_not_called=share(outside, lambda r: not r.alarm),
        outside_unknown=share(outside, lambda r: r.verdict == "unknown"),
        unknown_auroc=area_under_roc([r.unknown_score for r in outside], [r.unknown_score for r in visible]),
        two=len(two),
        recall=_mean([r.recall for r in two]),
        precision=_mean([r.precision for r in two]),
        median_shrinkage=_median([r.shrinkage for r in visible]),
        median_placebo=_median([r.placebo for r in visible if np.isfinite(r.placebo)]),
        share_of_oracle=_median(oracles),
        oracles=len(oracles),
        median_dose_error=_median([d.error for d in doses]),
        doses_covered=proportion([hit for d in doses for hit in d.covered]),
        calibration_error=calibration_error(bins),
        reliability=bins,
        bias=_bias({"one effect": visible, "no effect": free}),
        by_effect=tuple(_of_effect(name, single) for name in sorted({r.truth[0] for r in single})),
        by_visibility=tuple(_so_visible(v, single) for v in _LADDER),
        confusion=tuple((*pair, n) for pair, n in sorted(Counter(map(_leading, visible)).items())),
        failures=tuple(r.capture for r in answered if len(r.truth) < 2 and not r.right),
        controls=controls,
        rows=tuple(rows),
    )  # fmt: skip


def _leading(row: Row) -> tuple[str, str]:
    return row.truth[0], row.first[0] if row.first else "-"


def _of_effect(name: str, single: Sequence[Row]) -> EffectScore:
    here = [row for row in single if row.truth[0] == name]
    first = Counter(_leading(row)[1] for row in here).most_common()
    return EffectScore(
        name, proportion([r.right_first for r in here]), proportion([r.called for r in here]), tuple(first)
    )


def _so_visible(visibility: float, single: Sequence[Row]) -> VisibilityScore:
    here = [row for row in single if min(_LADDER, key=lambda v: abs(np.log(row.visibility / v))) == visibility]
    return VisibilityScore(
        visibility, proportion([r.right_first for r in here]), proportion([r.called for r in here]),
        proportion([r.alarm and not r.called for r in here]),
    )  # fmt: skip


def _shuffled(single: Sequence[Row]) -> float:
    """Mean over all ways to give each capture another one's label."""
    return _mean([
        bool(row.first) and same_class(row.first[0], other.truth[0])
        for row in single
        for other in single
        if row is not other
    ])  # fmt: skip


def _bias(parts: dict[str, Sequence[Row]]) -> dict[str, Bias]:
    out = {}
    for what, rows in parts.items():
        for name in ("log10_youngs_modulus", "poisson_ratio"):
            off = np.array([getattr(row, f"bias_{name}")[1] for row in rows])
            if len(off):
                median, most = np.quantile(np.abs(off), (0.5, 0.9))
                out[f"{name}, {what}"] = Bias(float(off.mean()), float(off.std()), float(median), float(most))
    return out


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else float("nan")
