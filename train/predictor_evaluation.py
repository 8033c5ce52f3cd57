"""Accuracy of E and ν, and its dependence on the motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from models import ClipEstimate, PreparedClip, freeze_time, shuffle_time
from physconvex import InputError
from train.held_out import Evaluated, evaluated_clips, held_out_estimates
from train.options import EvaluationOptions
from train.progress import Report
from train.records import LabelledClip, read_clips
from train.validation import DensityMetrics, density_metrics

Truth = Float64[np.ndarray, "2 N"]
"""log10 E and ν."""
Estimated = Float64[np.ndarray, "2 N 3"]
"""Of both: median, ends of the interval."""


@dataclass(frozen=True)
class Decade:
    """Metrics of the clips with E in [low, high) Pa."""

    low: float
    high: float
    log10_youngs_modulus: DensityMetrics
    poisson_ratio: DensityMetrics


@dataclass(frozen=True)
class Reading:
    """The network's output for the clips in one frame order."""

    name: str
    log10_youngs_modulus: DensityMetrics
    poisson_ratio: DensityMetrics
    decades: tuple[Decade, ...]


@dataclass(frozen=True, eq=False)
class PredictorEvaluation:
    """All frame orders of the same clips, with the single results of the first."""

    of: Evaluated
    objects: int
    readings: tuple[Reading, ...]
    truth: Truth
    estimated: Estimated

    def table(self) -> str:
        """For people: errors and coverage of each reading, then the decades of the first."""
        lines = [f"{self.readings[0].poisson_ratio.clips} clips of {self.objects} objects ({self.of.split})"]
        lines.append(f"{'':24}{'MAE log10 E':>12}{'MAE nu':>9}{'cover E':>9}{'cover nu':>9}")
        for reading in self.readings:
            lines.append(_row(reading.name, reading.log10_youngs_modulus, reading.poisson_ratio))
        first = self.readings[0]
        constant = (first.log10_youngs_modulus.constant_mae, first.poisson_ratio.constant_mae)
        lines.append(f"{'constant':24}{constant[0]:12.3f}{constant[1]:9.4f}")
        for d in first.decades:
            lines.append(_row(f"  {d.low:.0e}..{d.high:.0e} Pa", d.log10_youngs_modulus, d.poisson_ratio))
        return "\n".join(lines)


def _row(name: str, stiffness: DensityMetrics, poisson: DensityMetrics) -> str:
    return (
        f"{name:24}{stiffness.mae:12.3f}{poisson.mae:9.4f}{stiffness.coverage:9.1%}{poisson.coverage:9.1%}"
        f"  width {stiffness.width:.2f} {poisson.width:.3f}  n={stiffness.clips}"
    )


def evaluate_predictor(
    data: Sequence[Path | str],
    options: EvaluationOptions,
    *,
    out: Path,
    training_data: Sequence[Path | str] | None = None,
    report: Report | None = None,
) -> PredictorEvaluation:
    """Evaluate the clips of a split in order, in random frame order, and as a single frame.

    The constant predictor is the median of the training clips of `training_data`, or of `data` unless given; without
    training clips, of those for validation.
    """
    evaluated, predictor, clips = evaluated_clips(data, options, out=out, report=report)
    training = _not_tested(training_data or data)
    constants = np.median(_truth(training), axis=1).tolist()
    generator = np.random.default_rng(options.seed)
    ways: dict[str, Callable[[PreparedClip], PreparedClip]] = {
        "frames in order": lambda clip: clip,
        "frames shuffled": partial(shuffle_time, generator=generator),
        "a single frame": freeze_time,
    }
    truth = _truth(clips.labels)
    readings, tables = [], []
    for name, change in ways.items():
        progress = None if report is None else partial(report, name)
        estimates = list(held_out_estimates(predictor, clips, change=change, report=progress))
        tables.append(_columns(estimates))
        readings.append(_reading(name, tables[-1], truth, constants))
    objects = len({clip.record.row["object_id"] for clip in clips.labels})
    return PredictorEvaluation(evaluated, objects, tuple(readings), truth, tables[0])


def _not_tested(data: Sequence[Path | str]) -> list[LabelledClip]:
    """Training clips, or those for validation if there are none."""
    clips = read_clips(data)
    for split in ("train", "validation"):
        found = [clip for clip in clips if clip.record.row["split"] == split]
        if found:
            return found
    raise InputError(
        f"training_data: {', '.join(map(str, data))} hold no clip of the splits train and validation, whose median "
        "the constant predictor says; give the data set that the checkpoint was trained on"
    )


def _truth(clips: Sequence[LabelledClip]) -> Truth:
    return np.array([(np.log10(clip.youngs_modulus), clip.poisson_ratio) for clip in clips]).T


def _columns(estimates: Sequence[ClipEstimate]) -> Estimated:
    modulus = np.log10([(e.youngs_modulus, *e.youngs_modulus_interval) for e in estimates])
    return np.stack([modulus, [(e.poisson_ratio, *e.poisson_ratio_interval) for e in estimates]])


def _reading(name: str, estimated: Estimated, truth: Truth, constants: Sequence[float]) -> Reading:
    def metrics(chosen: np.ndarray) -> tuple[DensityMetrics, DensityMetrics]:
        stiffness, poisson = (
            density_metrics(*np.column_stack([table, values])[chosen].T, constant=constant)
            for table, values, constant in zip(estimated, truth, constants, strict=True)
        )
        return stiffness, poisson

    powers = np.floor(truth[0]).astype(int)
    decades = (Decade(10.0**power, 10.0 ** (power + 1), *metrics(powers == power)) for power in np.unique(powers))
    return Reading(name, *metrics(np.full(len(powers), True)), tuple(decades))


def write_predictor_report(out: Path, result: PredictorEvaluation) -> None:
    """`predictor.json` (with the command) and `predictor.png`."""
    readings = [asdict(reading) for reading in result.readings]
    result.of.write(out / "predictor.json", {"objects": result.objects, "readings": readings})
    _draw(out / "predictor.png", result)


def _draw(path: Path, result: PredictorEvaluation) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.2), layout="constrained")
    axes = figure.subplots(1, 3)
    names = ("log10(E / Pa)", "Poisson's ratio")
    for axis, truth, table, name in zip(axes, result.truth, result.estimated, names, strict=False):
        bars = np.abs(table[:, 1:] - table[:, :1]).T
        axis.errorbar(truth, table[:, 0], yerr=bars, fmt="o", ms=3, lw=0.5, alpha=0.5)
        axis.axline((truth.mean(), truth.mean()), slope=1, color="black", lw=1)
        axis.set(xlabel=f"{name}, true", ylabel="estimated, with 90 % interval", title=name)
    first = result.readings[0]
    places = np.arange(len(first.decades))
    for offset, name, values in (
        (-0.2, "|error| of log10 E", [d.log10_youngs_modulus.mae for d in first.decades]),
        (0.2, "10 |error| of ν", [10 * d.poisson_ratio.mae for d in first.decades]),
    ):
        axes[2].bar(places + offset, values, width=0.4, label=name)
    axes[2].axhline(10 * first.poisson_ratio.constant_mae, color="C1", ls=":", label="10 |error| of ν, constant")
    axes[2].set_xticks(places, [f"{d.low:.0e}" for d in first.decades])
    axes[2].set(xlabel="decade of E from [Pa]", title="mean error by stiffness")
    axes[2].set_ylim(top=1.4 * axes[2].get_ylim()[1])  # room for the names
    axes[2].legend(loc="upper left")
    figure.savefig(path, dpi=130)
