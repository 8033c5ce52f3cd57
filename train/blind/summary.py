"""Scores in files, one by one and of several banks together; for people tables in Markdown, and a figure."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from data_gen import ControlScore
from physconvex import InputError
from train.blind.rows import Row
from train.blind.scoring import BankScore, score_rows


def score_json(score: BankScore) -> str:
    """The complete score; unknown values are null."""
    return json.dumps(_known(asdict(score)), indent=1, allow_nan=False) + "\n"


def _known(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _known(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_known(part) for part in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


@dataclass(frozen=True)
class _Stored:
    """Fields of a stored score that determine the rest."""

    rows: tuple[Row, ...]
    controls: tuple[ControlScore, ...]
    undrawn: int


def pool_scores(results: Sequence[Path]) -> BankScore:
    """The score of all captures of banks that have a score each.

    Args:
        results: files that `score` writes.

    Raises:
        InputError: no result is given, one cannot be read, or a capture is in two of them.
    """
    if not results:
        raise InputError("results: got none; expected files that `physconvex evaluate gap score` wrote")
    banks = [_stored(path) for path in results]
    rows = [row for bank in banks for row in bank.rows]
    names = [row.capture for row in rows]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"results: {twice[0]} is in two of them; expected each bank once")
    controls = tuple(control for bank in banks for control in bank.controls)
    return score_rows(rows, controls, sum(bank.undrawn for bank in banks))


def _stored(path: Path) -> _Stored:
    try:
        content = TypeAdapter(dict[str, Any]).validate_json(path.read_bytes())
        rows = TypeAdapter(list[dict[str, Any]]).validate_python(content.get("rows"))
        return TypeAdapter(_Stored).validate_python(content | {"rows": [_numbers(row) for row in rows]})
    except (OSError, ValidationError) as error:
        raise InputError(f"{path}: no result of `physconvex evaluate gap score`, or an older one: {error}") from error


def _numbers(row: dict[str, Any]) -> dict[str, Any]:
    """Unknown numbers are null in the file."""
    return {name: value if name == "dose" else _number(value) for name, value in row.items()}


def _number(value: Any) -> Any:
    if isinstance(value, list):
        return [_number(part) for part in value]
    return float("nan") if value is None else value


def score_markdown(score: BankScore) -> str:
    """All tables of a score, with the targets of the protocol."""
    parts = [_table(("", "value", "aim"), _figures(score))]
    parts.append(_table(
        ("visibility", "class first", "called with the right class", "called with a wrong one"),
        [(f"{v.visibility:g}", v.right_first, v.called, v.wrong_calls) for v in score.by_visibility],
    ))  # fmt: skip
    parts.append(_table(
        ("effect, at all visibilities", "class first", "called", "what leads the fits"),
        [(e.name, e.right_first, e.called, ", ".join(f"{n} {k}" for n, k in e.first)) for e in score.by_effect],
    ))  # fmt: skip
    if score.controls:
        parts.append(_table(
            ("control", "capture", "answer", ""),
            [(c.name, c.capture, " ".join((c.verdict, *c.effects)), "right" if c.right else "**wrong**")
             for c in score.controls],
        ))  # fmt: skip
    parts.append(_table(
        ("capture", "hidden", "visibility", "gap [mm]", "answer", "fits led by", "error of log10 E"),
        [_row(row) for row in score.rows],
    ))  # fmt: skip
    return "\n\n".join(parts) + "\n"


def _figures(score: BankScore) -> list[tuple[object, ...]]:
    return [
        ("class ranked first", score.top_1_merged, "≥ .85"),
        ("class among the first two", score.top_2_merged, "≥ .95"),
        ("effect ranked first", score.top_1, ""),
        ("class first, if labels were dealt at random", _told(score.shuffled), "chance"),
        ("called with the right class", score.called, ""),
        ("calls that are right, at all visibilities", score.calls_right, ""),
        ("false alarms on captures without effect", score.false_alarms, "≤ .05"),
        ("effect in no dictionary: not called", score.outside_not_called, ""),
        ("effect in no dictionary: `unknown`", score.outside_unknown, ""),
        ("unknown, area under ROC", _told(score.unknown_auroc), "≥ .92"),
        (
            f"two effects ({score.two}): recall / precision",
            f"{_told(score.recall)} / {_told(score.precision)}",
            "≥ .85 / .9",
        ),
        ("median share of the held-out gap removed", _told(score.median_shrinkage), ""),
        (f"median of it over the oracle's ({score.oracles})", _told(score.share_of_oracle), "≥ .9"),
        ("median share that a placebo removes", _told(score.median_placebo), "≤ .03"),
        ("median error of doses", _told(score.median_dose_error), "≤ .15"),
        ("doses in their 90 % intervals", score.doses_covered, ".85 to .95"),
        ("calibration error", _told(score.calibration_error), "≤ .05"),
        *(
            (
                f"off by, {name}: mean ± deviation; absolutes: median, 90th percentile",
                f"{bias.mean:+.3f} ± {bias.deviation:.3f}; {bias.median:.3f}, {bias.most:.3f}",
                "mean within the deviation without effect" if "one effect" in name else "",
            )
            for name, bias in score.bias.items()
        ),
    ]


def _told(value: float) -> str:
    """A dash for values that a bank does not have, as in `Proportion`."""
    return "-" if np.isnan(value) else f"{value:.2f}"


def _row(row: Row) -> tuple[object, ...]:
    hidden = " + ".join(row.truth) or "none"
    if row.without:
        hidden += " (without it)" if row.outside else " (something taken out)"
    answer = row.error if row.verdict == "error" else row.verdict
    if row.alarm:
        answer = f"effect: {row.named} ({row.probability:.2f})"
    gap = " → ".join(f"{1e3 * v:.1f}" for v in (row.gap_before, row.gap_after))
    bias = " → ".join(f"{v:+.2f}" for v in row.bias_log10_youngs_modulus)
    return (
        row.capture.replace("capture_", ""), f"{row.kind}: {hidden}", f"{row.visibility:g}" if row.truth else "",
        f"{gap} ({1e3 * row.noise_floor:.1f})", answer, ", ".join(row.first[:2]), bias,
    )  # fmt: skip


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def draw_score(score: BankScore, path: Path) -> None:
    """Confusion of visible single effects, reliability of probabilities, and accuracy by visibility, as a picture."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(16, 6.4), layout="constrained")
    confusion, sure, seen = figure.subplots(1, 3, width_ratios=(1.5, 1, 1))
    hidden = sorted({truth for truth, _, _ in score.confusion})
    told = [*hidden, *sorted({name for _, name, _ in score.confusion} - set(hidden))]
    counts = np.zeros((len(hidden), len(told)))
    for truth, name, number in score.confusion:
        counts[hidden.index(truth), told.index(name)] = number
    confusion.imshow(counts, cmap="Blues", aspect="auto")
    for (i, j), count in np.ndenumerate(counts):
        if count:
            dark = count > 0.6 * counts.max()
            confusion.text(j, i, f"{count:.0f}", ha="center", va="center", color="white" if dark else "black")
    confusion.set_xticks(range(len(told)), told, rotation=60, ha="right")
    confusion.set_yticks(range(len(hidden)), hidden)
    confusion.set(xlabel="leads the fits", ylabel="hidden", title="One effect, visibility 10 and more")
    sure.plot([0, 1], [0, 1], color="grey", linewidth=1)
    sure.scatter(
        [b.probability for b in score.reliability], [b.right for b in score.reliability],
        s=[20 + 10 * b.count for b in score.reliability],
    )  # fmt: skip
    for b in score.reliability:
        sure.annotate(str(b.count), (b.probability, b.right), ha="center", va="center", fontsize=7)
    sure.set(xlabel="probability told", ylabel="share that is right", title="Reliability (number of answers)",
             xlim=(-0.05, 1.05), ylim=(-0.05, 1.05))  # fmt: skip
    where = np.arange(len(score.by_visibility))
    for name, label in (
        ("right_first", "class first"),
        ("called", "called, right class"),
        ("wrong_calls", "called, wrong"),
    ):
        part = [getattr(v, name) for v in score.by_visibility]
        value = np.array([p.value for p in part])
        spread = np.abs(np.array([(p.lower, p.upper) for p in part]).reshape(-1, 2).T - value)
        seen.errorbar(where, value, yerr=spread, marker="o", capsize=3, label=label)
    seen.set_xticks(where, [f"{v.visibility:g}" for v in score.by_visibility])
    seen.set(xlabel="visibility", ylabel="share of captures", ylim=(0, 1.02), title="By visibility (95 % intervals)")
    seen.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)
